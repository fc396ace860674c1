"""Fixed-point numbers: positions as integers of tolerance / 256, residuals as steps of two lattices."""

import math

UNITS = 256  # units per tolerance
MAX_DECODED = 1 << 41

CUBIC, CENTRED = 0, 1
# Units per step, by lattice.
NORMAL = (293, 227)
FINE = (256, 198)


def to_i64(value):
    """Casts towards zero, clamped to 64 bits; 0 for NaN."""
    if value != value:
        return 0
    return int(max(-(2.0**63), min(2.0**63, value))) - (value >= 2.0**63)


def wrap(value):
    """Wraps modulo 2^64."""
    return (value + (1 << 63)) % (1 << 64) - (1 << 63)


def nearest(value):
    """Rounds to the nearest integer, halves up."""
    if -1e15 < value < 1e15:
        return math.floor(value + 0.5)
    shifted = value + 0.5
    cut = to_i64(shifted)
    return max(cut - (float(cut) > shifted), -(2**63))


def divided(a, b):
    """Division as in IEEE 754, including by zero."""
    try:
        return a / b
    except ZeroDivisionError:
        if a == 0 or a != a:
            return math.nan
        return math.copysign(math.inf, a) * math.copysign(1.0, b)


def distance(a, b):
    """Converts units to tolerances."""
    x, y, z = float(a[0] - b[0]), float(a[1] - b[1]), float(a[2] - b[2])
    return math.sqrt(x * x + y * y + z * z) / UNITS
