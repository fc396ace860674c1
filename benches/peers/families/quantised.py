"""Byte compressors after quantisation to a grid of 2 tolerance/sqrt3, 0 to 3 differences along time, and packing.

The order of differences, the order of samples and the packing are chosen for each take and tolerance, without charging
the codec for the choice. Slow compressors try only the combinations that a fast LZMA finds smallest, unless EXHAUSTIVE.
"""

import lzma
import os
import platform
from functools import lru_cache

import brotli
import numpy as np
import zstandard

from families.base import Codec, Way, lowered
from families.integers import PACKINGS, difference, integrate, quantise, restore

EXHAUSTIVE = os.environ.get("PEERS_EXHAUSTIVE") == "1"
# Of 24 combinations. An exhaustive run on four takes at 0.1, 1 and 10 mm always found the smallest among these.
TRIED_BY_SLOW = 6
LZMA = {"format": lzma.FORMAT_ALONE}  # no container: 13 bytes before the data


def pack(take, axis, order, major, packing):
    residuals = difference(quantise(take, axis), order)
    return PACKINGS[packing][0](residuals if major == "channel" else np.ascontiguousarray(residuals.T))


def unpack(take, data, axis, order, major, packing):
    channels, frames = take.filled.shape
    if major == "channel":
        residuals = PACKINGS[packing][1](data, (channels, frames))
    else:
        residuals = np.ascontiguousarray(PACKINGS[packing][1](data, (frames, channels)).T)
    return restore(integrate(residuals, order), axis)


def xz(data):
    return lzma.compress(data, preset=9 | lzma.PRESET_EXTREME, **LZMA)


COMPRESSORS = {
    "xz": (xz, lzma.decompress, f"lzma of Python {platform.python_version()}", True),
    "zstd-19": (lambda d: zstandard.compress(d, 19), zstandard.decompress, f"zstandard {zstandard.__version__}", True),
    "zstd-3": (lambda d: zstandard.compress(d, 3), zstandard.decompress, f"zstandard {zstandard.__version__}", False),
    "brotli-11": (
        lambda d: brotli.compress(d, quality=11, lgwin=24),
        brotli.decompress,
        f"brotli {brotli.__version__}",
        True,
    ),
}

SHAPES = [(o, m, p) for o in range(4) for m in ("channel", "frame") for p in PACKINGS]


@lru_cache(maxsize=64)
def ranking(key):
    """The combinations in ascending order of their size with a fast LZMA."""
    take, axis = key.take, key.axis
    sizes = {}
    for shape in SHAPES:
        sizes[shape] = len(lzma.compress(pack(take, axis, *shape), preset=1, **LZMA))
    return sorted(SHAPES, key=sizes.get)


class Key:
    """(take, axis tolerance) with a hash, for `lru_cache`."""

    def __init__(self, take, axis):
        self.take, self.axis = take, axis

    def __hash__(self):
        return hash((self.take.sha256, self.take.gaps, self.axis))

    def __eq__(self, other):
        mine, yours = self.take, other.take
        return (mine.sha256, mine.gaps, self.axis) == (yours.sha256, yours.gaps, other.axis)


class Quantised(Codec):
    """Encodes all combinations, then decodes and measures the smallest."""

    def way(self, shape):
        compress, expand, _, _ = COMPRESSORS[self.name.removeprefix("q+delta+")]
        order, major, packing = shape

        def encode(take, axis):
            self.axis = axis
            return compress(pack(take, axis, *shape))

        def decode(take, payload):
            return unpack(take, expand(payload), self.axis, *shape)

        return Way(f"delta{order} {major}-major {packing}", encode, decode)

    def way_named(self, take, layout):
        return next(way for way in map(self.way, SHAPES) if way.name == layout)

    def best(self, take, tolerance_mm, tuned=True):
        # The grid step is the largest that guarantees the bound: there is nothing to tune.
        slow = COMPRESSORS[self.name.removeprefix("q+delta+")][3]
        axis = tolerance_mm / np.sqrt(3)
        shapes = ranking(Key(take, axis)) if slow and not EXHAUSTIVE else SHAPES
        shapes = shapes[:TRIED_BY_SLOW] if slow and not EXHAUSTIVE else shapes
        sizes = {shape: len(self.way(shape).encode(take, axis)) for shape in shapes}
        return lowered(take, self.way(min(sizes, key=sizes.get)), tolerance_mm)


def codecs():
    return [
        Quantised(f"q+delta+{name}", version, lambda take: [], timed=name != "brotli-11")
        for name, (_, _, version, _) in COMPRESSORS.items()
    ]
