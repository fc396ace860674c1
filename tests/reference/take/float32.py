"""float32 arithmetic in a language with float64 only."""

import math
import struct

_FLOAT = struct.Struct("<f")


def f32(value):
    """The nearest float32, ties to even; infinite beyond its range."""
    try:
        return _FLOAT.unpack(_FLOAT.pack(value))[0]
    except OverflowError:
        return math.copysign(math.inf, value)


def from_bits(bits):
    return struct.unpack("<f", struct.pack("<I", bits))[0]
