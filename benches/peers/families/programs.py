"""Compressors that are not packages: programs that the bench runs where they are installed.

HPEZ (the second version of QoZ) is an error-bounded compressor with tuned interpolation. Its source builds with CMake:

    git clone https://github.com/szcompressor/QoZ
    cmake -S QoZ -B QoZ/build -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_FLAGS="-include array"
    cmake --build QoZ/build --target qoz

The bench finds `qoz` on PATH, or by its path in QOZ; without it HPEZ is left out.
"""

import os
import shutil
import subprocess
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from families.base import Codec, Way
from families.scientific import arrangements

# 1 is QoZ 1.1, 2 to 4 are the levels of HPEZ; 0, which is SZ3, is compared by its own package.
LEVELS = (1, 2, 3, 4)

# It takes milliseconds; a layout in which it hangs is left out.
TIMEOUT_S = 60


def qoz():
    """The path of the program, or None."""
    return os.environ.get("QOZ") or shutil.which("qoz")


def run(arguments, shape):
    """Runs qoz, which names the axis that varies fastest first."""
    command = [qoz(), "-f", *map(str, arguments), f"-{len(shape)}", *map(str, reversed(shape))]
    try:
        subprocess.run(command, check=True, capture_output=True, timeout=TIMEOUT_S)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as problem:
        raise ValueError(f"qoz refuses {shape}: {problem}") from problem


def encode(array, level, tolerance):
    with tempfile.TemporaryDirectory(dir=fast_folder()) as folder:
        source, packed = Path(folder) / "in", Path(folder) / "out"
        array.astype(np.float32).tofile(source)
        run(["-i", source, "-z", packed, "-M", "ABS", repr(tolerance), "-q", level], array.shape)
        return packed.read_bytes()


def decode(shape, payload):
    with tempfile.TemporaryDirectory(dir=fast_folder()) as folder:
        packed, unpacked = Path(folder) / "in", Path(folder) / "out"
        packed.write_bytes(payload)
        run(["-z", packed, "-o", unpacked], shape)
        return np.fromfile(unpacked, np.float32).reshape(shape)


def fast_folder():
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


def ways(take):
    for name, array, back in arrangements(take):
        for level in LEVELS:
            yield Way(
                f"{name}, level {level}",
                lambda _, tol, a=array, q=level: encode(a, q, float(tol)),
                lambda _, payload, b=back, decoded=partial(decode, array.shape): b(decoded(payload)),
            )


def codecs():
    # Not tuned: each of its steps is a process. At bound/sqrt(3) an axis it is compared like the others.
    return [Codec("HPEZ", "QoZ 2.0", ways)] if qoz() else []
