"""A body that walks in a circle, for the mock: a function of the seed and the time, in plain Python.

It only has to look like a person; measurements use the generator of mocapd-sim.
"""

import math
import random

SITES = ["head", "throat", "pelvis", "l_shoulder", "l_elbow", "l_wrist", "r_shoulder", "r_elbow", "r_wrist",
         "l_hip", "l_knee", "l_ankle", "r_hip", "r_knee", "r_ankle"]
BONES = [(2, 1), (1, 0), (1, 3), (3, 4), (4, 5), (1, 6), (6, 7), (7, 8), (2, 9), (9, 10), (10, 11), (2, 12), (12, 13),
         (13, 14)]
SEGMENTS = [("trunk", 2, 1, 130), ("l_thigh", 9, 10, 75), ("r_thigh", 12, 13, 75), ("l_shank", 10, 11, 55),
            ("r_shank", 13, 14, 55), ("l_upper_arm", 3, 4, 45), ("r_upper_arm", 6, 7, 45), ("l_forearm", 4, 5, 35),
            ("r_forearm", 7, 8, 35), ("head", 1, 0, 90)]


class Body:
    """`n` markers: the 15 sites, then clusters on the segments, then unlabelled strays."""

    def __init__(self, n, seed, strays=0):
        draw = random.Random(seed)
        self.labels = SITES[:n]
        self.clusters = []
        for i in range(max(0, n - len(SITES) - strays)):
            name, a, b, radius = SEGMENTS[i % len(SEGMENTS)]
            self.labels.append(f"{name}_{i // len(SEGMENTS) + 1}")
            self.clusters.append((a, b, radius, draw.uniform(0.1, 0.9), draw.uniform(0, 2 * math.pi)))
        n_known = len(self.labels)
        self.labels += [f"u{slot + 1:03}" for slot in range(n_known, n)]
        self.labelled = [slot < n_known for slot in range(n)]
        self.strays = [(draw.uniform(-1500, 1500), draw.uniform(-1500, 1500), draw.uniform(20, 1900))
                       for _ in range(n - n_known)]
        self.bones = [bone for bone in BONES if max(bone) < n]
        # Some markers are occluded more often: period, phase and duration of the occlusions of each.
        self.occlusions = [(draw.uniform(4, 30), draw.uniform(0, 30), draw.choice([0, 0, 0, 0.15, 0.4, 1.2, 2.5]))
                       for _ in range(n)]
        self.noise = draw

    def is_visible(self, slot, t):
        period, phase, gap = self.occlusions[slot]
        return (t + phase) % period >= gap

    def positions(self, t):
        """Positions by slot in millimetres, z up; None if occluded."""
        sites = _pose(t)[:len(self.labels)]
        out = list(sites)
        for a, b, radius, along, turn in self.clusters:
            (ax, ay, az), (bx, by, bz) = sites[a], sites[b]
            heading = 0.35 * t
            side, front = radius * math.cos(turn), radius * math.sin(turn)
            out.append((ax + (bx - ax) * along + front * math.cos(heading) - side * math.sin(heading),
                        ay + (by - ay) * along + front * math.sin(heading) + side * math.cos(heading),
                        az + (bz - az) * along))
        out += [(x + 30 * math.sin(t + x), y + 30 * math.cos(t + y), z) for x, y, z in self.strays]
        jitter = self.noise.gauss
        return [(x + jitter(0, .1), y + jitter(0, .1), z + jitter(0, .1)) if self.is_visible(slot, t) else None
                for slot, (x, y, z) in enumerate(out)]


def _pose(t):
    """The sites of a body walking round the centre of the room, at slightly under two steps per second."""
    step = 2 * math.pi * 0.9 * t
    heading = 0.35 * t + math.pi / 2
    forward = (math.cos(heading), math.sin(heading))
    left = (-forward[1], forward[0])
    centre = (1300 * math.cos(0.35 * t), 1300 * math.sin(0.35 * t))

    def at(ahead, aside, height):
        return (centre[0] + forward[0] * ahead + left[0] * aside, centre[1] + forward[1] * ahead + left[1] * aside,
                height)

    bob = 22 * math.cos(2 * step)
    sites = [at(40, 0, 1640 + bob), at(15, 0, 1455 + bob), at(0, 0, 930 + bob)]
    for sign in (1, -1):
        swing = -0.55 * sign * math.sin(step)
        shoulder = (15, 190 * sign, 1410 + bob)
        elbow = (shoulder[0] + 300 * math.sin(swing), 215 * sign, shoulder[2] - 300 * math.cos(swing))
        bent = swing + 0.35 + 0.25 * max(0.0, math.sin(swing))
        wrist = (elbow[0] + 255 * math.sin(bent), 200 * sign, elbow[2] - 255 * math.cos(bent))
        sites += [at(*shoulder), at(*elbow), at(*wrist)]
    for sign in (1, -1):
        swing = 0.45 * sign * math.sin(step)
        hip = (0, 95 * sign, 910 + bob)
        knee = (hip[0] + 420 * math.sin(swing + 0.12), 95 * sign, hip[2] - 420 * math.cos(swing + 0.12))
        lift = swing - 0.1 - 0.8 * max(0.0, math.cos(step) * sign)
        ankle = (knee[0] + 420 * math.sin(lift), 90 * sign, max(70, knee[2] - 420 * math.cos(lift)))
        sites += [at(*hip), at(*knee), at(*ankle)]
    return sites
