"""The indices of the contexts: one family after another, each with its first index."""

SPAN = 64
LEVELS = 6
# First row of a run; anchor of a long, a medium and a short span; strides 1, 2, 4, 8, 16, 32.
KINDS = 4 + LEVELS
ORIGIN_KIND = 0

UNARY = 4  # larger magnitudes are Exp-Golomb coded
EXPONENTS = 24  # those with contexts of their own
CANDIDATES = 16
MAX_EXPONENT = 42

_next = 0


def _family(length):
    global _next
    first = _next
    _next += length
    return first


MOVING_REFERENCES = _family(KINDS * 6 * 8)
MOVING_EXPECTED = _family(KINDS * 32 * 3)
ODD = _family(KINDS)
NONZERO_REFERENCES = _family(KINDS * 6 * 8 * 6)
NONZERO_EXPECTED = _family(KINDS * 32 * 6)
SIGN_REFERENCES = _family(KINDS * 9)
SIGN_SIDE = _family(KINDS * 9)
LONGER_NEAR = _family(KINDS * UNARY * 6)
LONGER_REFERENCES = _family(3 * UNARY * 6 * 8)
LONGER_EXPECTED = _family(3 * 32 * UNARY)
EXPONENT_EXPECTED = _family(32 * EXPONENTS)
EXPONENT_REFERENCES = _family(EXPONENTS * 6 * 8)
TOP_BIT = _family(EXPONENTS * 32)
NEXT_BIT = _family(EXPONENTS * 2)
ORIGIN_EXPONENT = _family(3 * 3 * 48)
ORIGIN_OWN = _family(8)
ORIGIN_NONE = _family(1)
ORIGIN_RANK = _family(CANDIDATES)
RAW = _family(3)
FINE = _family(3)
N_CONTEXTS = _next

# Mixers: moving, nonzero and sign by kind; longer and exponents by position.
MIX_MOVING = 0
MIX_NONZERO = MIX_MOVING + KINDS
MIX_SIGN = MIX_NONZERO + KINDS
MIX_LONGER = MIX_SIGN + KINDS
MIX_EXPONENT = MIX_LONGER + 3
N_MIXERS = MIX_EXPONENT + 7
