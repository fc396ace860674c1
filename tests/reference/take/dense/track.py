"""The decoded state of one channel."""

from .anchor import Anchor
from .lattice import NORMAL
from .layout import KINDS

MEMORY = 64  # rows before the block
ZERO = (0, 0, 0)


class End:
    """The last sample of a run."""

    def __init__(self, row, point):
        self.row = row  # since the key block
        self.point = point
        self.taken = False  # a later run continues from here


class Track:
    def __init__(self):
        self.points = [ZERO] * MEMORY
        self.steps = [ZERO] * MEMORY
        self.run_start = 0
        self.fineness = NORMAL
        self.reset()

    def reset(self):
        self.known = [False] * MEMORY
        self.activity = [0] * KINDS
        self.axis_activity = [[0] * 3 for _ in range(KINDS)]
        self.anchor = Anchor()
        self.end = None
        self.was_raw = self.was_fine = 0

    def begin(self, n_rows):
        self.points = self.points[:MEMORY] + [ZERO] * n_rows
        self.steps = self.steps[:MEMORY] + [ZERO] * n_rows
        self.known = self.known[:MEMORY] + [False] * n_rows

    def finish(self, n_rows):
        self.points = self.points[n_rows:]
        self.steps = self.steps[n_rows:]
        self.known = self.known[n_rows:]
        self.run_start = max(self.run_start - n_rows, 0)

    def steps_from(self, start, row):
        """Coded magnitudes with signs; None before `start`."""
        return self.steps[row] if row >= start and self.known[row] else ZERO

    def settle(self, row, kind, point, steps):
        self.points[row] = point
        self.known[row] = True
        activity, axes = self.activity, self.axis_activity[kind]
        if steps == ZERO:
            self.steps[row] = ZERO
            activity[kind] += -activity[kind] * 51 >> 8
            for axis in range(3):
                axes[axis] += -axes[axis] * 51 >> 8
            return
        self.steps[row] = tuple(max(-1000, min(1000, step)) for step in steps)
        magnitudes = [min(abs(step), 2000) for step in steps]
        activity[kind] += (sum(magnitudes) * 256 - activity[kind]) * 51 >> 8
        for axis, magnitude in enumerate(magnitudes):
            axes[axis] += (magnitude * 256 - axes[axis]) * 51 >> 8


def magnitude(step):
    """The magnitude as neighbours use it in their contexts."""
    return min(abs(step), 900)


def weight(steps):
    if steps == ZERO:
        return 0
    return magnitude(steps[0]) + magnitude(steps[1]) + magnitude(steps[2])
