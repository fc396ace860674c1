"""The syntax of one row: its contexts, and the bits of its residual."""

from ..errors import Corrupt
from . import layout as ctx
from .track import ZERO, magnitude, weight

EIGHT = (5, 20, 51, 102, 205, 410, 1024)


class Surroundings:
    """Coded magnitudes around a row: nearest rows of coarser levels, the two rows of its level before it."""

    __slots__ = ("kind", "left", "right", "before", "before_that", "bend", "side",
                 "references", "references_side")  # fmt: skip

    def __init__(self, kind, left, right=ZERO, before=ZERO, before_that=ZERO, bend=0, side=ZERO):
        self.kind, self.left, self.right = kind, left, right
        self.before, self.before_that = before, before_that
        self.bend, self.side = bend, side
        self.references, self.references_side = ZERO, ZERO


def six(value):
    return value if value <= 2 else 3 if value <= 4 else 4 if value <= 9 else 5


def eight(activity):
    return sum(activity >= limit for limit in EIGHT)


def thirty_two(expectation):
    """Twice the binary logarithm: half octaves."""
    if expectation < 4:
        return 0
    octave = expectation.bit_length() - 1
    return min(1 + 2 * (octave - 2) + (expectation >> octave - 1 & 1), 31)


def sign(value):
    return 0 if value == 0 else 1 if value > 0 else 2


def residual(coder, model, track, around, centred):
    """Decodes lattice steps and coded magnitudes of one row, or None if it is unchanged."""
    kind = around.kind
    activity = track.activity[kind]
    before, before_that = weight(around.before), weight(around.before_that)
    left, right = weight(around.left), weight(around.right)
    references = sum(around.references)
    expectation = (
        (activity * 115 >> 8)
        + before * 51
        + before_that * 26
        + (left + right) * 20
        + references * 26
    )
    contexts = (
        ctx.MOVING_REFERENCES + (kind * 6 + six(references)) * 8 + eight(activity),
        ctx.MOVING_EXPECTED + (kind * 32 + thirty_two(expectation)) * 3 + around.bend,
    )
    if not model.mixed(coder, contexts, ctx.MIX_MOVING + kind):
        return None
    odd = centred and model.single(coder, ctx.ODD + kind)
    form = 0 if not centred else 1 if odd else 2
    coded, some = [], False
    for axis in range(3):
        certain = odd or axis == 2 and not some
        coded.append(axis_magnitude(coder, model, track, around, form, axis, some, certain))
        some = some or coded[axis] != 0
    steps = coded
    if form == 1:
        steps = [2 * c - (1 if c > 0 else -1) for c in coded]
    elif form == 2:
        steps = [2 * c for c in coded]
    return steps, tuple(coded)


def axis_magnitude(coder, model, track, around, form, axis, some, certain):
    kind = around.kind
    activity = track.axis_activity[kind][axis]
    before = magnitude(around.before[axis])
    left, right = magnitude(around.left[axis]), magnitude(around.right[axis])
    references = around.references[axis]
    expectation = (activity * 115 >> 8) + before * 51 + (left + right) * 20 + references * 26
    expected, active, referred = thirty_two(expectation), eight(activity), six(references)
    if not certain:
        order = (axis > 0) + (axis > 0 and some) + 3 * (form > 0)
        contexts = (
            ctx.NONZERO_REFERENCES + ((kind * 6 + referred) * 8 + active) * 6 + order,
            ctx.NONZERO_EXPECTED + (kind * 32 + expected) * 6 + order,
        )
        if not model.mixed(coder, contexts, ctx.MIX_NONZERO + kind):
            return 0
    last = sign(around.before[axis])
    contexts = (
        ctx.SIGN_REFERENCES + kind * 9 + around.references_side[axis] * 3 + last,
        ctx.SIGN_SIDE + kind * 9 + around.side[axis] * 3 + last,
    )
    negative = model.mixed(coder, contexts, ctx.MIX_SIGN + kind)
    near = six(max(before, left, right))
    length = 1 + longer(coder, model, kind, form, near, referred, active, expected)
    return -length if negative else length


def longer(coder, model, kind, form, near, referred, active, expected):
    """Decodes a magnitude minus one: unary at first, then Exp-Golomb."""
    for i in range(ctx.UNARY):
        contexts = (
            ctx.LONGER_NEAR + (kind * ctx.UNARY + i) * 6 + near,
            ctx.LONGER_REFERENCES + ((form * ctx.UNARY + i) * 6 + referred) * 8 + active,
            ctx.LONGER_EXPECTED + (form * 32 + expected) * ctx.UNARY + i,
        )
        if not model.mixed(coder, contexts, ctx.MIX_LONGER + min(i, 2)):
            return i
    exponent = 0
    while True:
        i = min(exponent, ctx.EXPONENTS - 1)
        contexts = (
            ctx.EXPONENT_REFERENCES + (i * 6 + referred) * 8 + active,
            ctx.EXPONENT_EXPECTED + expected * ctx.EXPONENTS + i,
        )
        if not model.mixed(coder, contexts, ctx.MIX_EXPONENT + min(exponent, 6)):
            break
        exponent += 1
        if exponent > ctx.MAX_EXPONENT:
            raise Corrupt("a residual beyond every coordinate")
    i = min(exponent, ctx.EXPONENTS - 1)
    value, left = 1, exponent
    if left > 0:
        left -= 1
        value = value << 1 | model.single(coder, ctx.TOP_BIT + i * 32 + expected)
    if left > 0:
        left -= 1
        value = value << 1 | model.single(coder, ctx.NEXT_BIT + i * 2 + (value & 1))
    return (value << left | coder.plain(left)) - 1 + ctx.UNARY


def origin(coder, model, way):
    """Decodes the residual of the first row of a run."""
    steps = []
    for axis in range(3):
        first = ctx.ORIGIN_EXPONENT + (way * 3 + axis) * 48
        exponent = 0
        while model.single(coder, first + exponent):
            exponent += 1
            if exponent > ctx.MAX_EXPONENT:
                raise Corrupt("a first row beyond every coordinate")
        length = (1 << exponent) + coder.plain(exponent) - 1
        steps.append(-length if length > 0 and coder.plain(1) else length)
    return tuple(steps)
