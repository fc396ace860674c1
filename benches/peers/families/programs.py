"""Compressors that are not packages: programs that the bench runs where they are installed.

HPEZ (the second version of QoZ) is an error-bounded compressor with tuned interpolation, LCP (SIGMOD 2025) one for
particles that move. Their sources build with CMake:

    git clone https://github.com/szcompressor/QoZ
    cmake -S QoZ -B QoZ/build -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_FLAGS="-include array"
    cmake --build QoZ/build --target qoz
    git clone https://github.com/LangdaoZhang/LCP
    cmake -S LCP -B LCP/build -DCMAKE_BUILD_TYPE=Release
    cmake --build LCP/build --target lcp

The bench finds `qoz` and `lcp` on PATH, or by their paths in QOZ and LCP; without one, its compressor is left out.
"""

import math
import os
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from families.base import Codec, Way
from families.scientific import arrangements

# 1 is QoZ 1.1, 2 to 4 are the levels of HPEZ; 0, which is SZ3, is compared by its own package.
LEVELS = (1, 2, 3, 4)

# The largest numbers of frames that LCP codes together; 16 is its default.
BATCHES_FRAMES = (16, 64, 256, 1024)
# LCP predicts the frames of a batch from the first one, which it may code with a bound that is five times finer. It can choose
# between the two bounds itself, but with fewer than 100 markers the choice does not terminate; so both are tried.
FINER = (1, 5)

# They take milliseconds; a layout in which one hangs is left out.
TIMEOUT_S = 60


def program(name):
    """The path of a program, or None."""
    return os.environ.get(name.upper()) or shutil.which(name)


def run(name, arguments):
    try:
        subprocess.run([program(name), *map(str, arguments)], check=True, capture_output=True, timeout=TIMEOUT_S)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as problem:
        raise ValueError(f"{name} refuses {arguments}: {problem}") from problem


def work_folder():
    return tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None)


def hpez_run(arguments, shape):
    """Runs qoz, which names the axis that varies fastest first."""
    run("qoz", ["-f", *arguments, f"-{len(shape)}", *reversed(shape)])


def hpez_encode(array, level, tolerance):
    with work_folder() as folder:
        source, packed = Path(folder) / "in", Path(folder) / "out"
        array.astype(np.float32).tofile(source)
        hpez_run(["-i", source, "-z", packed, "-M", "ABS", repr(tolerance), "-q", level], array.shape)
        return packed.read_bytes()


def hpez_decode(shape, payload):
    with work_folder() as folder:
        packed, unpacked = Path(folder) / "in", Path(folder) / "out"
        packed.write_bytes(payload)
        hpez_run(["-z", packed, "-o", unpacked], shape)
        return np.fromfile(unpacked, np.float32).reshape(shape)


def hpez_ways(take):
    for name, array, back in arrangements(take):
        for level in LEVELS:
            yield Way(
                f"{name}, level {level}",
                lambda _, tol, a=array, q=level: hpez_encode(a, q, float(tol)),
                lambda _, payload, b=back, decoded=partial(hpez_decode, array.shape): b(decoded(payload)),
            )


@dataclass
class Particles:
    """What LCP writes, and the order (frames, markers) in which it sorts the markers of each frame, which its decoder
    does not restore."""

    packed: bytes
    order: np.ndarray

    def size(self):
        """With what tells the markers apart: each order once, a bit for each frame that says whether its order is that
        of the frame before, and where it is not, the number of its order."""
        frames, markers = self.order.shape
        changes = np.count_nonzero((self.order[1:] != self.order[:-1]).any(axis=1))
        orders = len(np.unique(self.order, axis=0))
        bits = frames + orders * math.lgamma(markers + 1) / math.log(2) + changes * math.log2(orders)
        return len(self.packed) + math.ceil(bits / 8)


def lcp_encode(positions, batch_frames, finer, tolerance):
    """`positions`: (axes, frames, markers)."""
    _, frames, markers = positions.shape
    with work_folder() as folder:
        sources = [Path(folder) / axis for axis in "xyz"]
        packed, order = Path(folder) / "out", Path(folder) / "order"
        for source, values in zip(sources, positions):
            values.astype(np.float32).tofile(source)
        shape = ["-2", frames, markers, "-bt", batch_frames, "-fflag", finer]
        run("lcp", ["-i", *sources, "-z", packed, *shape, "-eb", repr(tolerance), "-ord", 32, order])
        # Places in the whole array.
        places = np.fromfile(order, np.uint32).reshape(frames, markers)
        return Particles(packed.read_bytes(), places - np.arange(frames, dtype=np.uint32)[:, None] * markers)


def lcp_decode(batch_frames, particles):
    frames, markers = particles.order.shape
    with work_folder() as folder:
        packed, unpacked = Path(folder) / "in", [Path(folder) / axis for axis in "xyz"]
        packed.write_bytes(particles.packed)
        run("lcp", ["-z", packed, "-o", *unpacked, "-2", frames, markers, "-bt", batch_frames])
        sorted_ = np.stack([np.fromfile(path, np.float32).reshape(frames, markers) for path in unpacked])
    positions = np.empty_like(sorted_)
    np.put_along_axis(positions, particles.order[None].astype(np.int64), sorted_, axis=2)
    return positions.transpose(2, 0, 1).reshape(markers * 3, frames)


def lcp_ways(take):
    positions = take.filled.reshape(len(take.filled) // 3, 3, -1).transpose(1, 2, 0)
    for batch_frames in BATCHES_FRAMES:
        for finer in FINER:
            yield Way(
                f"batches of {batch_frames}, first {finer} times finer",
                lambda _, tol, frames=batch_frames, finer=finer: lcp_encode(positions, frames, finer, float(tol)),
                lambda _, particles, frames=batch_frames: lcp_decode(frames, particles),
                size=Particles.size,
            )


def codecs():
    # Not tuned: each of its steps is a process. At bound/sqrt(3) an axis they are compared like the others.
    known = (("qoz", Codec("HPEZ", "QoZ 2.0", hpez_ways)), ("lcp", Codec("LCP", "LCP of 2025", lcp_ways)))
    return [codec for name, codec in known if program(name)]
