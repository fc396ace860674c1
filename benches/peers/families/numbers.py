"""Lossless compressors of integers, images and sound on the quantised positions (grid 2 tolerance/sqrt3): pcodec,
Blosc2, JPEG-XL, FLAC."""

import io

import blosc2
import imagecodecs
import numpy as np
import soundfile
from pcodec import ChunkConfig, DeltaSpec, __version__ as PCO_VERSION
from pcodec.standalone import simple_compress, simple_decompress

from families.base import Codec, Way
from families.integers import difference, integrate, quantise, restore, unzigzag, zigzag


def on_grid(name, encode, decode):
    """A layout from an encoder and a decoder of (channels, frames) int32; it stores the grid of its last payload."""
    grid = {}

    def forth(take, axis):
        grid["axis"] = axis
        return encode(quantise(take, axis))

    return Way(name, forth, lambda take, payload: restore(decode(payload, take.filled.shape), grid["axis"]))


def pco_ways(take):
    """Differences computed by pcodec across all channels end to end, or here for each channel separately."""
    own = {"auto": DeltaSpec.auto()} | {f"delta{n}": DeltaSpec.try_consecutive(n) for n in (1, 2, 3)}
    for name, delta in own.items():
        config = ChunkConfig(compression_level=12, delta_spec=delta)
        yield on_grid(
            f"channels end to end, {name}",
            lambda q, c=config: simple_compress(q.ravel(), c),
            lambda data, shape: simple_decompress(data).reshape(shape),
        )
    plain = ChunkConfig(compression_level=12, delta_spec=DeltaSpec.no_op())
    for order in (1, 2, 3):
        yield on_grid(
            f"channel by channel, delta{order}",
            lambda q, n=order: simple_compress(difference(q, n).ravel(), plain),
            lambda data, shape, n=order: integrate(simple_decompress(data).reshape(shape), n),
        )


def blosc_ways(take):
    for order in (1, 2, 3):
        for filter_name, filter_ in (("shuffle", blosc2.Filter.SHUFFLE), ("bitshuffle", blosc2.Filter.BITSHUFFLE)):

            def encode(q, order=order, filter_=filter_):
                words = zigzag(difference(q, order))
                return blosc2.compress(words, typesize=4, clevel=9, filter=filter_, codec=blosc2.Codec.ZSTD)

            def decode(data, shape, order=order):
                words = np.frombuffer(blosc2.decompress(data), np.uint32)
                return integrate(unzigzag(words).reshape(shape), order)

            yield on_grid(f"delta{order} {filter_name}", encode, decode)


def jxl_ways(take):
    for order in (0, 1, 2):
        for across in (False, True):

            def encode(q, order=order, across=across):
                lows = q.min(axis=1, keepdims=True)
                image = q - lows if order == 0 else zigzag(difference(q - lows, order)).astype(np.int64)
                if image.max(initial=0) > 65535:
                    raise ValueError("more than 16 bits")
                image = image.astype(np.uint16)
                image = np.ascontiguousarray(image.T) if across else image
                data = imagecodecs.jpegxl_encode(image, lossless=True, effort=9, photometric="gray", numthreads=1)
                return lows.astype("<i4").tobytes() + data

            def decode(data, shape, order=order, across=across):
                lows = np.frombuffer(data, "<i4", shape[0])[:, None]
                image = imagecodecs.jpegxl_decode(data[4 * shape[0] :], numthreads=1)
                image = (image.T if across else image).reshape(shape).astype(np.uint32)
                return (image.astype(np.int32) if order == 0 else integrate(unzigzag(image), order)) + lows

            yield on_grid(f"delta{order} {'frames by channels' if across else 'channels by frames'}", encode, decode)


def flac_ways(take):
    """All channels one after another in a mono stream, with 16 bits where the grid numbers fit, else 24."""

    def encode(q):
        centres = (q.min(axis=1, keepdims=True) + q.max(axis=1, keepdims=True)) // 2
        sound = (q - centres).ravel()
        if np.abs(sound).max(initial=0) >= 1 << 23:
            raise ValueError("more than 24 bits")
        narrow = np.abs(sound).max(initial=0) < 1 << 15
        samples = sound.astype(np.int16) if narrow else sound << 8
        file = io.BytesIO()
        subtype = "PCM_16" if narrow else "PCM_24"
        soundfile.write(file, samples, 48000, format="FLAC", subtype=subtype, compression_level=1.0)
        return centres.astype("<i4").tobytes() + file.getvalue()

    def decode(data, shape):
        centres = np.frombuffer(data, "<i4", shape[0])[:, None]
        sound, _ = soundfile.read(io.BytesIO(data[4 * shape[0] :]), dtype="int32")
        shift = 16 if soundfile.info(io.BytesIO(data[4 * shape[0] :])).subtype == "PCM_16" else 8
        return (sound >> shift).reshape(shape) + centres

    yield on_grid("channels end to end", encode, decode)


def codecs():
    return [
        Codec("pcodec", f"pcodec {PCO_VERSION}", pco_ways, timed=True),
        Codec("Blosc2 zstd", f"blosc2 {blosc2.__version__}", blosc_ways),
        Codec("JPEG-XL", f"imagecodecs {imagecodecs.__version__}", jxl_ways),
        Codec("FLAC", f"soundfile {soundfile.__version__} {soundfile.__libsndfile_version__}", flac_ways),
    ]
