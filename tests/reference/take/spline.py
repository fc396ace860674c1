"""`spline`: natural cubic splines through kept samples (docs/codec.md, "spline")."""

import math
import struct

from .columns import read_channel
from .cursor import Cursor
from .errors import Corrupt
from .float32 import f32


def read_position(cursor):
    position = struct.unpack("<3f", cursor.take(12))
    if not all(map(math.isfinite, position)):
        raise Corrupt("a knot that is not finite")
    return position


def moments(knots):
    """Second derivatives at the knots, (row, position) each: forward sweep, then back."""
    n = len(knots)
    values = [(0.0, 0.0, 0.0)] * n
    sweep = []
    upper, right = 0.0, values[0]
    for i in range(1, n - 1):
        (x0, y0), (x1, y1), (x2, y2) = knots[i - 1 : i + 2]
        h0, h1 = float(x1 - x0), float(x2 - x1)
        pivot = 2.0 * (h0 + h1) - h0 * upper
        bends = [6.0 * ((c - b) / h1 - (b - a) / h0) for a, b, c in zip(y0, y1, y2)]
        right = tuple((bend - h0 * r) / pivot for bend, r in zip(bends, right))
        upper = h1 / pivot
        sweep.append((upper, right))
    for i in range(n - 2, 0, -1):
        upper, right = sweep[i - 1]
        values[i] = tuple(r - upper * m for r, m in zip(right, values[i + 1]))
    return values


def rebuild(knots, n_rows):
    """All rows of a run whose first and last rows are knots."""
    out = [knots[0][1]] * n_rows
    values = moments(knots)
    for i in range(len(knots) - 1):
        (x0, y0), (x1, y1) = knots[i], knots[i + 1]
        h = float(x1 - x0)
        for row in range(x0, x1 + 1):
            a, b = (x1 - row) / h, (row - x0) / h
            ca = (a * a * a - a) * (h * h / 6.0)
            cb = (b * b * b - b) * (h * h / 6.0)
            out[row] = tuple(
                f32(a * p + b * q + (ca * m + cb * n))
                for p, q, m, n in zip(y0, y1, values[i], values[i + 1])
            )
    return out


def place(channel, start, rows, cursor, n_rows):
    """One run: the positions of its knots, then all its rows."""
    knots = [(row, read_position(cursor)) for row in rows]
    rebuilt = rebuild(knots, n_rows)
    if not all(math.isfinite(value) for position in rebuilt for value in position):
        raise Corrupt("a spline that is not finite")
    channel.positions[start : start + n_rows] = rebuilt
    for row in rows:
        channel.kept[start + row] = True


class Spline:
    """The payloads of a group; no state is kept between blocks."""

    EXACT = False

    def __init__(self, _tolerance_mm):
        pass

    def reset(self):
        pass

    def break_off(self):
        pass

    def decode(self, payload, shared, channels):
        self.begin(shared, len(channels[0].present))
        cursor = Cursor(payload)
        for channel in channels:
            if not any(channel.present):
                continue
            mode = cursor.byte()
            if mode > 1:
                raise Corrupt("an unknown mode of a channel")
            if mode == 1:
                read_channel(cursor, channel)
                continue
            for start, end in channel.runs():
                place(channel, start, self.knots(cursor, start, end), cursor, end - start)
        cursor.finish()

    def begin(self, shared, n_rows):
        """`spline` shares nothing between channels."""

    def knots(self, cursor, start, end):
        """The kept rows of a run, counted from its first row."""
        n = end - start
        rows = [0]
        if n > 2:
            inner = cursor.varint()
            if inner > n - 2:
                raise Corrupt("more knots than samples")
            for _ in range(inner):
                rows.append(rows[-1] + 1 + cursor.varint())
                if rows[-1] >= n - 1:
                    raise Corrupt("a knot beyond its run")
        return rows + [n - 1] if n > 1 else rows
