"""One run of present rows of `fast` (docs/codec.md, "fast", "Residuals" and "Rows"). All float32."""

from .errors import Corrupt
from .float32 import f32
from .tans import LARGER, QUIET, QUIET_ROWS, WAKE, axes_of

ANCHOR, ORIGIN = 5, 6
SPAN = 32
TAIL = SPAN + 1

# By table index.
GOLOMB = [0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3, 2, 2, 0, 0]
LOW_BITS = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 3, 6, 0, 0]
GUESSES = [(1, 0.0), (2, 1.0), (4, 1.0), (8, 1.0), (8, 0.5), (32, 1.0), (32, 0.5)]
NEW_ACTIVITY = [1 << 8, 2 << 8, 4 << 8, 8 << 8, 16 << 8, 64 << 8, 255 << 8]


def add(a, b):
    return f32(a + b)


def sub(a, b):
    return f32(a - b)


def mul(a, b):
    return f32(a * b)


class Memory:
    """The state of one channel from block to block."""

    def __init__(self):
        self.tail = [[0.0] * 3 for _ in range(TAIL)]
        self.known = 0
        self.activity = NEW_ACTIVITY[:]
        self.errors = [[0.0] * 3 for _ in GUESSES]


def extent(n):
    full = max(n - 1, 0) // SPAN * SPAN
    power = 1
    while power < n - full:
        power *= 2
    return full + power


def run(bits, memory, step, cap, n_samples):
    """Points and kept flags of one run."""
    kept = set()
    n = n_samples
    has_origin = memory.known == 0
    if has_origin:
        [residual] = residuals(bits, memory, ORIGIN, 1)
        memory.tail[-1] = settle(memory.tail[-1], residual, step)
        if any(residual):
            kept.add(0)
        memory.known = 1
        n -= 1
    # Row r of the run; row 0 is the last row before it, or the origin.
    points = {r - SPAN: memory.tail[r] for r in range(TAIL)}
    if n > 0:
        end = extent(n)
        anchors(bits, memory, points, end, step, cap, kept)
        stride = SPAN // 2
        while stride:
            level(bits, memory, points, n, end, stride, step, kept)
            stride //= 2
    memory.tail = [points[n - SPAN + r] for r in range(TAIL)]
    memory.known = min(memory.known + n, TAIL)
    rows = range(0 if has_origin else 1, n + 1)
    return [points[r] for r in rows], [r in kept for r in rows]


def residuals(bits, memory, level, count):
    out = []
    while len(out) < count:
        e = memory.activity[level]
        if e == 0:
            zeros = bits.symbol(QUIET)
            out += [[0, 0, 0]] * min(zeros, count - len(out))
            if zeros == QUIET_ROWS:
                continue
            if len(out) == count:
                raise Corrupt("a row beyond its level")
            table = WAKE
        else:
            table = max(e.bit_length(), 3) - 3
        axes = axes_of(bits.symbol(table))
        low_bits = LOW_BITS[table]
        low = [bits.take(low_bits) for _ in range(3)] if low_bits else [0, 0, 0]
        residual = []
        for code, low in zip(axes, low):
            value = bits.larger(GOLOMB[table]) if code == LARGER else (0, 1, -1)[code]
            residual.append((value << low_bits) + low - ((1 << low_bits) >> 1))
        out.append(residual)
        new = min(sum(map(abs, residual)), 255) << 8
        memory.activity[level] = e + ((new - e) >> 2)
    return out


def settle(prediction, residual, step):
    return [add(p, mul(f32(float(r)), step)) for p, r in zip(prediction, residual)]


def anchors(bits, memory, points, end, step, cap, kept):
    rows = list(range(SPAN, end, SPAN)) + [end]
    start = 0
    for row, residual in zip(rows, residuals(bits, memory, ANCHOR, len(rows))):
        last = points[start]
        guesses = []
        for window, weight in GUESSES:
            if start > 0:
                window = 2 * SPAN if window == SPAN and start > SPAN else SPAN
            guess = last
            if weight and (start > 0 or window < memory.known):
                before = points[start - window]
                factor = f32((row - start) * weight / window)
                guess = [add(a, mul(sub(a, b), factor)) for a, b in zip(last, before)]
            guesses.append(guess)
        prediction = []
        for axis in range(3):
            best = min(range(len(GUESSES)), key=lambda g: memory.errors[g][axis])
            prediction.append(guesses[best][axis])
        point = settle(prediction, residual, step)
        points[row] = point
        if any(residual):
            kept.add(row)
        for errors, guess in zip(memory.errors, guesses):
            for axis in range(3):
                off = min(abs(sub(guess[axis], point[axis])), cap)
                errors[axis] = add(mul(errors[axis], 0.875), off)
        start = row


def level(bits, memory, points, n, end, stride, step, kept):
    rows = range(stride, end - stride + 1, 2 * stride)
    coded = [row for row in rows if row <= n]
    found = residuals(bits, memory, stride.bit_length() - 1, len(coded))
    for i, row in enumerate(rows):
        near = (points[row - stride], points[row + stride])
        left = points[row - 3 * stride] if 3 * stride - row < memory.known else None
        right = points[row + 3 * stride] if row + 3 * stride <= end else None
        prediction = [
            predict(
                left and left[axis], near[0][axis], near[1][axis], right and right[axis]
            )
            for axis in range(3)
        ]
        if row <= n:
            if any(found[i]):
                kept.add(row)
            prediction = settle(prediction, found[i], step)
        points[row] = prediction


def predict(a, b, c, d):
    if a is not None and d is not None:
        near = add(b, c)
        return add(mul(0.5, near), mul(sub(near, add(a, d)), 0.0625))
    if a is not None:
        return mul(sub(add(mul(b, 6.0), mul(c, 3.0)), a), 0.125)
    if d is not None:
        return mul(sub(add(mul(c, 6.0), mul(b, 3.0)), d), 0.125)
    return mul(0.5, add(b, c))
