"""Error-bounded compressors of scientific arrays: SZ3, SPERR, ZFP. Their size depends on the layout more than on
anything else, so each encodes channels end to end, rows of channels, rows of frames, and two 3-D arrangements.

SPERR transforms an axis alone when the other two are short, so its (frames, markers, 3) is in effect 1-D along time
with one coder for all channels.
"""

import imagecodecs
import numpy as np
import pysz
import zfpy

from families.base import Codec, Way


def arrangements(take):
    """Tuples of name, array, and a function from the decoded array to channels (markers * 3, frames)."""
    channels = take.filled
    count, frames = channels.shape
    cube = channels.reshape(-1, 3, frames)

    def back(axes, shape):
        inverse = np.argsort(axes)
        return lambda a: np.ascontiguousarray(a.reshape(shape).transpose(inverse)).reshape(count, frames)

    yield "1-D channels end to end", channels.ravel(), lambda a: a.reshape(count, frames)
    yield (
        "1-D x, y, z apart",
        np.ascontiguousarray(cube.transpose(1, 0, 2)).ravel(),
        back((1, 0, 2), (3, count // 3, frames)),
    )
    yield "2-D channels, frames", channels, lambda a: a.reshape(count, frames)
    yield "2-D frames, channels", np.ascontiguousarray(channels.T), lambda a: a.reshape(frames, count).T
    for name, axes in (("frames, markers, 3", (2, 0, 1)), ("markers, 3, frames", (0, 1, 2))):
        array = np.ascontiguousarray(cube.transpose(axes))
        yield f"3-D {name}", array, back(axes, array.shape)


def sz3_encode(array, tolerance, algorithm):
    config = pysz.szConfig(array.shape)
    config.errorBoundMode = pysz.szErrorBoundMode.ABS
    config.absErrorBound = tolerance
    config.cmprAlgo = algorithm
    return pysz.sz.compress(array, config)[0]


def sz3_ways(take):
    algorithms = {"": pysz.szAlgorithm.INTERP_LORENZO, ", Lorenzo": pysz.szAlgorithm.LORENZO_REG}
    for name, array, back in arrangements(take):
        for suffix, algorithm in algorithms.items():
            yield Way(
                name + suffix,
                lambda _, tol, a=array, g=algorithm: sz3_encode(a, tol, g),
                lambda _, data, a=array, b=back: b(pysz.sz.decompress(data, np.float32, a.shape)[0]),
            )


# SPERR indexes an axis with 16 bits: larger chunks decode to garbage or abort.
SPERR_AXIS_MAX = 32768


def sperr_ways(take):
    for name, array, back in arrangements(take):
        if array.ndim == 1:
            for chunk in (16384, SPERR_AXIS_MAX):
                yield sperr_way(
                    f"{name}, chunks of {chunk}", array.reshape(-1, 1, 1), (min(chunk, array.size), 1, 1), back
                )
        elif max(array.shape) <= SPERR_AXIS_MAX:
            yield sperr_way(name, array, array.shape if array.ndim == 3 else None, back)
    frames_by_channels = np.ascontiguousarray(take.filled.T)[:, :, None]
    shape = frames_by_channels.shape
    yield sperr_way("1-D along time, coded jointly", frames_by_channels, shape, lambda a: a.reshape(shape[:2]).T)


def sperr_way(name, array, chunks, back):
    return Way(
        name,
        lambda _, tol: imagecodecs.sperr_encode(array, tol, "pwe", chunks=chunks, numthreads=1),
        lambda _, data: back(imagecodecs.sperr_decode(data, numthreads=1)),
    )


def zfp_ways(take):
    for name, array, back in arrangements(take):
        yield Way(
            name,
            lambda _, tol, a=array: zfpy.compress_numpy(a, tolerance=tol),
            lambda _, data, b=back: b(zfpy.decompress_numpy(data)),
        )


def codecs():
    return [
        Codec("SZ3", f"pysz {pysz_version()}", sz3_ways, tuned=True, timed=True),
        Codec("SPERR", f"imagecodecs {imagecodecs.__version__}", sperr_ways, tuned=True, timed=True),
        Codec("ZFP", "zfpy 1.0.1", zfp_ways, tuned=True),
    ]


def pysz_version():
    from importlib.metadata import version

    return version("pysz")
