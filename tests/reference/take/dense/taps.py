"""The rows from which a row is interpolated, and its predicted position."""

from functools import cache

from .lattice import UNITS

SIDE_UNITS = 40


class Site:
    """A row and its neighbours. `start`, `zero` and `end` belong to its run."""

    __slots__ = ("at", "stride", "left", "right", "outer_right", "outer_left")

    def __init__(self, at, stride, start, zero, end):
        self.at, self.stride = at, stride
        self.left = max(at - stride, zero)
        self.right = min(at + stride, end)
        outer_right = min(at + 3 * stride, end)
        self.outer_right = outer_right if outer_right > self.right else None
        outer_left = None
        if at - 3 * stride >= start:
            outer_left = at - 3 * stride
        elif self.left == zero:
            outer_left = max(zero - 2 * stride, start)
        if outer_left is not None and outer_left >= self.left:
            outer_left = None
        self.outer_left = outer_left

    def is_even(self):
        at, stride = self.at, self.stride
        offsets = (self.left, self.right, self.outer_right, self.outer_left)
        return offsets == (at - stride, at + stride, at + 3 * stride, at - 3 * stride)

    def expect(self, points):
        """Point, curvature and side of each axis."""
        base, far = points[self.left], points[self.right]
        if self.is_even():
            right, left = points[self.outer_right], points[self.outer_left]
            curve = [
                (9 * (f - b) - ((r - b) + (l - b)) + 8) >> 4
                for b, f, r, l in zip(base, far, right, left)
            ]
        else:
            curve = self.lagrange(points)
        return self.describe(base, far, curve)

    def lagrange(self, points):
        """Distance of the polynomial from the left neighbour."""
        rows = [self.right, self.outer_right, self.outer_left]
        rows = [row for row in rows if row is not None]
        base = points[self.left]
        nodes = tuple(row - self.left for row in rows)
        total = [32768, 32768, 32768]
        for row, weight in zip(rows, weights(self.at - self.left, nodes)):
            point = points[row]
            for axis in range(3):
                total[axis] += (point[axis] - base[axis]) * weight
        return [value >> 16 for value in total]

    def describe(self, base, far, curve):
        before, whole = self.at - self.left, self.right - self.left
        point, side, bend = [], [0, 0, 0], 0
        for axis in range(3):
            point.append(base[axis] + curve[axis])
            off = curve[axis] - (far[axis] - base[axis]) * before // whole
            size = abs(off)
            if size > bend:
                bend = size
            if size >= SIDE_UNITS:
                side[axis] = 1 if off > 0 else 2
        bend = bend * 8 // UNITS
        return point, min((bend + 1) // 2, 2), side


@cache
def weights(at, nodes):
    """Weights of the nodes except the left one, which is row 0; in 2^-16, rounded half up."""
    out = []
    for node in nodes:
        numerator, denominator = 1 << 16, 1
        for other in (0, *nodes):
            if other != node:
                numerator *= at - other
                denominator *= node - other
        if denominator < 0:
            numerator, denominator = -numerator, -denominator
        out.append((2 * numerator + denominator) // (2 * denominator))
    return out
