"""A finished take of the mock for the player: its overview, windows of frames and gaps, as the service serves them."""

import math
import random
import struct

from mock_body import Body
from mock_rig import BODIES, body_values

BINS = 1024
WINDOW_BYTES_MAX = 1_000_000
#: Frames that are lost in every take, [first, end], in seconds.
LOST_S = (4.0, 4.25)
#: The frame and the marker at which the lossless take is farthest from the others.
WORST = (321, 5)
#: Frames that one response to /gaps covers.
PART_FRAMES = 2000


class MockTake:
    """A take called `plates...` has two force plates, one called `bodies...` three rigid bodies; one called `lossless...` is 0.3 mm along x from the others, and 9 mm at one
    sample."""

    def __init__(self, name, seconds, markers, rate_hz, seed=1, damaged=False):
        self.name, self.rate_hz, self.damaged = name, rate_hz, damaged
        self.frames = int(seconds * rate_hz)
        self.body = Body(markers, seed, strays=markers // 12)

    def is_lost(self, frame):
        return LOST_S[0] <= frame / self.rate_hz < LOST_S[1]

    def positions(self, frame):
        """By marker, or None where the sample is missing. A function of the frame alone."""
        if self.is_lost(frame):
            return [None] * len(self.body.labels)
        self.body.noise = random.Random(frame)
        found = self.body.positions(frame / self.rate_hz)
        if not self.name.startswith("lossless"):
            return found
        far = [9.0 if (frame, slot) == WORST else 0.3 for slot in range(len(found))]
        return [at and (at[0] + by, *at[1:]) for at, by in zip(found, far)]

    def difference(self, against, from_s=0.0):
        """The distances from another take of the same motion."""
        first = min(self.frames, round(from_s * self.rate_hz))
        end = min(self.frames, first + PART_FRAMES)
        bin_frames = max(1, math.ceil(self.frames / BINS))
        first_bin = first // bin_frames
        errors = [None] * (math.ceil(end / bin_frames) - first_bin)
        largest, samples, squares = None, 0, 0.0
        for frame in range(first, end):
            for slot, (a, b) in enumerate(zip(self.positions(frame), against.positions(frame))):
                if a is None or b is None:
                    continue
                error, at = math.dist(a, b), frame // bin_frames - first_bin
                samples, squares = samples + 1, squares + error ** 2
                errors[at] = max(errors[at] or 0.0, error)
                if largest is None or error > largest["error_mm"]:
                    largest = {"error_mm": error, "frame": frame, "marker": slot}
        return {"against": against.name, "first_frame": first, "end_frame": end, "frames": self.frames, "bin_frames": bin_frames,
                "first_bin": first_bin, "other_first": 0, "is_by_number": True, "other_first_number": 1, "frames_only_here": 0,
                "frames_only_there": 0, "markers": list(range(len(self.body.labels))), "markers_missing": 0,
                "max_error_mm": errors, "largest": largest, "samples": samples, "sum_of_squares_mm2": squares,
                "gaps_differing": 0, "is_damaged": False}

    def plates(self):
        if not self.name.startswith("plates"):
            return {"plates": [], "window_frames_max": 1, "unusable": []}
        corners = [[[x + dx, dy, 0.0] for dx, dy in ((450, 300), (-450, 300), (-450, -300), (450, -300))] for x in (0, 1200)]
        return {"plates": [{"name": str(i + 1), "corners_mm": at} for i, at in enumerate(corners)],
                "window_frames_max": (WINDOW_BYTES_MAX - 32) // (36 * 2), "unusable": []}

    def load(self, frame):
        """The loads of both plates: a body that stands on the first one, and jumps from there once in two seconds."""
        t = frame / self.rate_hz % 2.0
        up = 0.0 if 1.2 < t < 1.5 else 700.0 + 500.0 * math.sin(math.pi * t)
        cop = (40.0 * t, -20.0, 0.0) if up else (math.nan,) * 3
        return [[30.0, -20.0, up, *cop, 1.0 if up else math.nan, up - 5.0, up + 5.0], [0.0] * 3 + [math.nan] * 4 + [0.0, 0.0]]

    def forces(self, from_s=0.0, seconds=4.0, every=1):
        first = round(from_s * self.rate_hz)
        rows = range(first, min(self.frames, round((from_s + seconds) * self.rate_hz)), every)
        n = len(self.plates()["plates"])
        out = [b"MPF1", struct.pack("<IQIIII", n, first, len(rows), every, 0, 0)]
        for row in rows if n else []:
            out.append(struct.pack("<18f", *(value for load in self.load(row) for value in load)))
        return b"".join(out)

    def bodies(self):
        return {"names": BODIES if self.name.startswith("bodies") else [], "window_frames_max": (WINDOW_BYTES_MAX - 32) // (36 * 3)}

    def body_poses(self, from_s=0.0, seconds=4.0, every=1):
        first = round(from_s * self.rate_hz)
        rows = range(first, min(self.frames, round((from_s + seconds) * self.rate_hz)), every)
        out = [b"MPB1", struct.pack("<IQIIII", 3, first, len(rows), every, 0, 0)]
        out += [struct.pack("<27f", *body_values(row / self.rate_hz)) for row in rows]
        return b"".join(out)

    def missing(self, frame):
        return sum(not self.body.is_visible(slot, frame / self.rate_hz) for slot in range(len(self.body.labels)))

    def overview(self, is_complete=True):
        """Only a complete one has the events."""
        body = self.body
        events = [{"frame": int(0.4 * self.frames), "kind": "mark", "text": "take off <b>"},
                  {"frame": int(0.5 * self.frames), "kind": "host", "text": "the device was disconnected"},
                  {"frame": int(0.7 * self.frames), "kind": "mark", "text": ""}] if is_complete else []
        # The overview of a closed take does not know of damage within its stretches.
        problems = []
        return {"name": self.name, "source": "DVMC-8820 SIM-0001", "created_unix_ms": 0, "frames": self.frames,
                "first_frame": 1, "rate_hz": self.rate_hz, "seconds": self.frames / self.rate_hz, "markers": len(body.labels),
                "labels": body.labels, "labelled": body.labelled, "up_axis": 3, "bones": body.bones,
                "tolerance_mm": 0.5, "frames_lost": int((LOST_S[1] - LOST_S[0]) * self.rate_hz),
                "samples_missing": 1000, "events": events, "events_total": len(events), "problems": problems,
                "problems_total": len(problems), "is_complete": is_complete,
                "window_frames_max": (WINDOW_BYTES_MAX - 32) // (12 * max(1, len(body.labels)))}

    def window(self, from_s=0.0, seconds=4.0, every=1):
        first = round(from_s * self.rate_hz)
        end = min(self.frames, round((from_s + seconds) * self.rate_hz))
        rows = range(first, end, every)
        flags = 2 if self.damaged else 0
        out = [b"MPW1", struct.pack("<IQIIII", len(self.body.labels), first, len(rows), every, flags, 0)]
        nothing = (math.nan,) * 3
        for row in rows:
            values = [value for at in self.positions(row) for value in (at or nothing)]
            out.append(struct.pack(f"<{len(values)}f", *values))
        return b"".join(out)

    def gaps(self, from_s=0.0):
        first = min(self.frames, round(from_s * self.rate_hz))
        end = min(self.frames, first + PART_FRAMES)
        bin_frames = max(1, math.ceil(self.frames / BINS))
        first_bin = first // bin_frames
        n_bins = math.ceil(end / bin_frames) - first_bin
        missing, lost = [0] * n_bins, [0] * n_bins
        for frame in range(first, end):
            at = frame // bin_frames - first_bin
            if self.is_lost(frame):
                lost[at] += 1
            else:
                missing[at] += self.missing(frame)
        return {"first_frame": first, "end_frame": end, "frames": self.frames, "bin_frames": bin_frames,
                "first_bin": first_bin, "missing_samples": missing, "lost_frames": lost, "is_damaged": self.damaged}
