"""Which samples the resampler `dense` kept, found from the positions that come out of a take.

A skipped sample is exactly what its neighbours predict; a kept one is not. This is the order and the prediction
of docs/codec.md, section "dense", in integers of a 256th of the tolerance. A marker without gaps is assumed.
"""

GUESSES = [(1, 0), (2, 4), (4, 4), (8, 4), (8, 2), (32, 4), (32, 2)]
SPAN = 32
MAX_ERROR = 1 << 24


def kept_rows(positions_mm, tolerance_mm, stretch_rows):
    """Rows kept of one marker's [(x, y, z), ...]; `stretch_rows`: rows of each stretch, the first one a key stretch."""
    points = [[round(v * 256 / tolerance_mm) for v in position] for position in positions_mm]
    kept = [0] if any(points[0]) else []
    errors = [[0] * len(GUESSES) for _ in range(3)]
    at, stop = 1, 0
    for n_rows in stretch_rows:
        stop += n_rows
        while at < stop:
            m = min(stop - at, SPAN)
            kept += kept_in_span(points, at - 1, m, errors)
            at += m
    return sorted(kept)


def kept_in_span(points, zero, m, errors):
    """Rows kept of the `m` rows after row `zero`."""
    kept = []
    known = min(zero + 1, SPAN + 1)
    if points[zero + m] != anchor(points, zero, m, known, errors):
        kept.append(zero + m)
    for stride in (16, 8, 4, 2, 1):
        for row in range(stride, m, 2 * stride):
            if points[zero + row] != interpolated(points, zero, row, stride, m, known):
                kept.append(zero + row)
    return kept


def anchor(points, zero, m, known, errors):
    """The prediction of a span's last row; scores the guesses."""
    prediction = []
    for axis in range(3):
        guesses = []
        for window, quarters in GUESSES:
            window = min(window, known - 1)
            last = points[zero][axis]
            travelled = last - points[zero - window][axis]
            guesses.append(last + travelled * m * quarters // (4 * window) if window else last)
        pick = min(range(len(GUESSES)), key=lambda i: errors[axis][i])
        prediction.append(guesses[pick])
        for i, guess in enumerate(guesses):
            off = min(abs(guess - points[zero + m][axis]), MAX_ERROR)
            errors[axis][i] += off - errors[axis][i] // 8
    return prediction


def interpolated(points, zero, row, stride, m, known):
    """The prediction of a row between rows known already."""
    right, outer_right, outer_left = min(row + stride, m), min(row + 3 * stride, m), row - 3 * stride
    nodes = [row - stride, right]
    nodes += [outer_right] if outer_right > right else []
    nodes += [outer_left] if outer_left + known - 1 >= 0 else []
    base = points[zero + nodes[0]]
    weights = [weight(row, nodes, i) for i in range(1, len(nodes))]
    offs = [[points[zero + node][axis] - base[axis] for node in nodes[1:]] for axis in range(3)]
    return [
        base[axis] + (((1 << 15) + sum(w * off for w, off in zip(weights, offs[axis]))) >> 16)
        for axis in range(3)
    ]


def weight(at, nodes, i):
    """Lagrange's weight of `nodes[i]` at `at`, in 2^-16, rounded half up."""
    numerator, denominator = 1 << 16, 1
    for j, other in enumerate(nodes):
        if j != i:
            numerator *= at - other
            denominator *= nodes[i] - other
    if denominator < 0:
        numerator, denominator = -numerator, -denominator
    return (2 * numerator + denominator) // (2 * denominator)
