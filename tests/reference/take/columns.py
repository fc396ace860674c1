"""Bit-exact samples: docs/codec.md, "Columns"."""

import math

from .errors import Corrupt
from .float32 import from_bits

GROUP = 32
MASK = (1 << 64) - 1


def signed(value):
    """Wraps modulo 2^64."""
    value &= MASK
    return value - (1 << 64) if value >> 63 else value


def unzigzag(value):
    return value >> 1 ^ -(value & 1)


class History:
    """The last values of one axis, newest last, at most two."""

    def __init__(self):
        self.values = []

    def decode(self, order, zigzagged):
        values = self.values
        prediction = 0
        if order == 1:
            prediction = values[-1]
        elif order == 2:
            prediction = 2 * values[-1] - values[-2]
        value = signed(prediction + unzigzag(zigzagged))
        self.values = (values + [value])[-2:]
        return value


def read_column(cursor, n, history, order):
    column = []
    while len(column) < n and len(history.values) < order:
        column.append(history.decode(len(history.values), cursor.varint()))
    while len(column) < n:
        count = min(GROUP, n - len(column))
        width = cursor.byte()
        if width > 64:
            raise Corrupt("a group wider than 64 bits")
        packed = int.from_bytes(cursor.take((count * width + 7) // 8), "little")
        for i in range(count):
            column.append(history.decode(order, packed >> i * width & ((1 << width) - 1)))
    return column


def to_float(ordered):
    if not -(1 << 31) <= ordered < 1 << 31:
        raise Corrupt("a value not finite")
    bits = ordered & 0xFFFFFFFF
    value = from_bits(bits ^ 0x7FFFFFFF if bits >> 31 else bits)
    if not math.isfinite(value):
        raise Corrupt("a value not finite")
    return value


def read_channel(cursor, channel, histories=None):
    """Decodes the present rows of a channel; all of them are kept samples."""
    histories = histories or [History() for _ in range(3)]
    rows = [row for row, present in enumerate(channel.present) if present]
    head = cursor.byte()
    orders = [head >> 2 * axis & 3 for axis in range(3)]
    if head >> 6 or 3 in orders:
        raise Corrupt("unknown columns")
    columns = [read_column(cursor, len(rows), histories[axis], orders[axis]) for axis in range(3)]
    for row, values in zip(rows, zip(*columns)):
        channel.positions[row] = tuple(map(to_float, values))
        channel.kept[row] = True
