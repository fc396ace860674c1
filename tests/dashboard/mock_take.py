"""A finished take of the mock for the player: its overview, windows of frames and gaps, as the service serves them."""

import math
import random
import struct

from mock_body import Body

BINS = 1024
WINDOW_BYTES_MAX = 1_000_000
#: Frames that are lost in every take, [first, end], in seconds.
LOST_S = (4.0, 4.25)
#: Frames that one response to /gaps covers.
PART_FRAMES = 2000


class MockTake:
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
        return self.body.positions(frame / self.rate_hz)

    def missing(self, frame):
        return sum(not self.body.is_visible(slot, frame / self.rate_hz) for slot in range(len(self.body.labels)))

    def overview(self):
        body = self.body
        events = [{"frame": int(0.4 * self.frames), "kind": "mark", "text": "take off <b>"},
                  {"frame": int(0.5 * self.frames), "kind": "host", "text": "the device was disconnected"},
                  {"frame": int(0.7 * self.frames), "kind": "mark", "text": ""}]
        # The overview of a closed take does not know of damage within its stretches.
        problems = []
        return {"name": self.name, "source": "DVMC-8820 SIM-0001", "created_unix_ms": 0, "frames": self.frames,
                "rate_hz": self.rate_hz, "seconds": self.frames / self.rate_hz, "markers": len(body.labels),
                "labels": body.labels, "labelled": body.labelled, "up_axis": 3, "bones": body.bones,
                "tolerance_mm": 0.5, "frames_lost": int((LOST_S[1] - LOST_S[0]) * self.rate_hz),
                "samples_missing": 1000, "events": events, "events_total": len(events), "problems": problems,
                "problems_total": len(problems),
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
