"""Segments of constant length: prediction from distances to other markers. Distances in tolerances, float64."""

import math

from .lattice import UNITS
from .layout import KINDS

CHANNELS = 64
PARTNERS = 3
NEAR = 6
LEAST_SEEN = 6.0
MEMORY_ROWS = 60.0
MAX_DIFFERENCE = 50.0
DECAY = 0.98
RIDGE = 1.0
LEAST_SHARE = 0.05


def clamp(value):
    return min(max(value, -MAX_DIFFERENCE), MAX_DIFFERENCE)


def along(first, last, left, at, right):
    """Linear interpolation between two rows."""
    return first + (last - first) * float(at - left) / float(right - left)


class Lengths:
    def __init__(self):
        self.reset()

    def reset(self):
        # By channel and earlier channel: variance, and the number of observations.
        self.spreads = [[[0.0, 0.0] for _ in range(j)] for j in range(CHANNELS)]
        # By channel, kind, slot: sums of squares and products, and the resulting share.
        self.shares = [
            [[[0.0, 0.0, 0.0] for _ in range(PARTNERS)] for _ in range(KINDS)] for _ in range(CHANNELS)
        ]
        self.near = [[] for _ in range(CHANNELS)]
        self.partners = [[] for _ in range(CHANNELS)]

    def choose(self, j, nearness):
        """Chooses partners for a span. Sorting is stable: at a tie the first one comes first."""
        near = sorted(range(j), key=lambda k: -nearness[k])[:NEAR]
        spreads = self.spreads[j]
        steady = [k for k in range(j) if spreads[k][1] >= LEAST_SEEN]
        partners = sorted(steady, key=lambda k: spreads[k][0])[:PARTNERS]
        if not partners and near and nearness[near[0]] > 0.0:
            partners = near[:1]
        self.near[j], self.partners[j] = near, partners

    def begin(self, j, kind):
        """Begins a level: a share without observations starts as that of the level above."""
        for slot, share in enumerate(self.shares[j][kind]):
            if 4 <= kind < KINDS - 1 and share[0] == 0.0:
                share[2] = self.shares[j][kind + 1][slot][2]

    def shares_of(self, j, kind):
        """The current shares."""
        return [share[2] for share in self.shares[j][kind]]

    def aim(self, own, partner, length):
        """Excess of a point's distance from a partner, and the direction away from it; None without a direction."""
        x, y, z = (e - float(p) for e, p in zip(own, partner))
        far = math.sqrt(x * x + y * y + z * z)
        if far < UNITS:
            return None
        inverse = 1.0 / far
        return far / UNITS - length, (x * inverse, y * inverse, z * inverse)

    def score(self, j, kind, pull, point):
        """Updates a share with the fraction of a correction that was right."""
        slot, difference, direction, start = pull
        truth = 0.0
        for axis in range(3):
            off = (start[axis] - float(point[axis])) / UNITS
            truth += off * direction[axis]
        difference, truth = clamp(difference), clamp(truth)
        share = self.shares[j][kind][slot]
        share[0] = share[0] * DECAY + difference * difference
        share[1] = share[1] * DECAY + difference * truth
        share[2] = min(share[1] / (share[0] + RIDGE), 1.0)

    def learn(self, j, k, distance, length):
        """Updates the variance with the deviation of a distance from its interpolation in time."""
        spread = self.spreads[j][k]
        off = min(abs(distance - length), MAX_DIFFERENCE)
        spread[0] += (off * off - spread[0]) / (min(spread[1], MEMORY_ROWS) + 1.0)
        spread[1] += 1.0
