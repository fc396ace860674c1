"""The size of the mask of missing samples, which every lossy codec needs in addition to its payload. The mask is stored
as packed bits, by frame or by marker, plain or as changes over time, raw or compressed with zstd-19 or LZMA: the
smallest of these counts."""

import lzma

import numpy as np
import zstandard


def candidates(present):
    changes = present.copy()
    changes[1:] ^= present[:-1]
    for bits in (present, changes):
        yield np.packbits(bits)
        yield np.packbits(bits.T)


def mask_bytes(present):
    """Bytes added to every codec; one byte for a take without gaps."""
    if present.all():
        return 1
    sizes = [1 + len(candidate) for candidate in candidates(present)]
    for candidate in candidates(present):
        data = candidate.tobytes()
        sizes.append(1 + len(zstandard.compress(data, 19)))
        sizes.append(1 + len(lzma.compress(data, lzma.FORMAT_ALONE, preset=9 | lzma.PRESET_EXTREME)))
    return min(sizes)
