"""Quantised positions and their packings: the input of the byte and integer compressors."""

import numpy as np


def quantise(take, axis_tolerance):
    """Int32 grid numbers, one channel per row. The step is 2 * axis tolerance, so that the error of each axis is within
    the tolerance."""
    # In float64, because grid numbers at 0.1 mm need up to 18 bits and rounding must not add to the error.
    grid = np.rint(take.filled * np.float64(0.5 / axis_tolerance))
    if np.abs(grid).max(initial=0) >= 2**27:
        raise ValueError("grid numbers too wide to difference in 32 bits")
    return grid.astype(np.int32)


def restore(grid, axis_tolerance):
    return (grid * (2.0 * axis_tolerance)).astype(np.float32)


def difference(grid, order):
    """Differences of `order` along time. The first samples of a channel have lower orders, so that only one is
    large."""
    out = grid.copy()
    for step in range(order):
        out[:, step + 1 :] = np.diff(out[:, step:], axis=1)
    return out


def integrate(residuals, order):
    out = residuals.copy()
    for step in reversed(range(order)):
        out[:, step:] = np.cumsum(out[:, step:], axis=1, dtype=np.int32)
    return out


def zigzag(values):
    return ((values << 1) ^ (values >> 31)).view(np.uint32)


def unzigzag(values):
    return (values >> 1).astype(np.int32) ^ -(values & 1).astype(np.int32)


def to_varints(values):
    """LEB128 of the zigzag numbers."""
    numbers = zigzag(values.ravel())
    lengths = np.ones(len(numbers), np.int64)
    for bits in (7, 14, 21, 28):
        lengths += numbers >= (1 << bits)
    ends = np.cumsum(lengths)
    out = np.zeros(int(ends[-1]) if len(ends) else 0, np.uint8)
    starts = ends - lengths
    for place in range(int(lengths.max(initial=0))):
        has = lengths > place
        byte = (numbers[has] >> (7 * place)) & 127
        out[starts[has] + place] = byte | np.where(lengths[has] > place + 1, 128, 0)
    return out.tobytes()


def from_varints(data, shape):
    octets = np.frombuffer(data, np.uint8)
    ends = np.flatnonzero(octets < 128)
    starts = np.concatenate([[0], ends[:-1] + 1])
    place = np.arange(len(octets)) - np.repeat(starts, ends - starts + 1)
    parts = (octets & 127).astype(np.uint32) << (7 * place).astype(np.uint32)
    return unzigzag(np.add.reduceat(parts, starts)).reshape(shape)


def width_of(values):
    """Bytes of the smallest signed integer that holds all values."""
    low, high = int(values.min(initial=0)), int(values.max(initial=0))
    return next(w for w in (1, 2, 4) if -(1 << (8 * w - 1)) <= low and high < 1 << (8 * w - 1))


def to_words(values):
    width = width_of(values)
    return bytes([width]) + values.astype(f"<i{width}").tobytes()


def from_words(data, shape):
    return np.frombuffer(data, f"<i{data[0]}", offset=1).astype(np.int32).reshape(shape)


def to_planes(values):
    """Byte planes of the zigzag numbers, the low bytes first."""
    width = width_of(values)
    words = zigzag(values.ravel()).astype(f"<u{width}")
    return bytes([width]) + np.ascontiguousarray(words.view(np.uint8).reshape(-1, width).T).tobytes()


def from_planes(data, shape):
    width = data[0]
    planes = np.frombuffer(data, np.uint8, offset=1).reshape(width, -1)
    words = np.ascontiguousarray(planes.T).view(f"<u{width}").astype(np.uint32)
    return unzigzag(words).reshape(shape)


PACKINGS = {"varints": (to_varints, from_varints), "words": (to_words, from_words), "planes": (to_planes, from_planes)}
