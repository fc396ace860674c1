"""Arrays into takes, and back."""

from __future__ import annotations

import os
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ._native import TakeError, TakeFile, encode

if TYPE_CHECKING:
    from ._native import Coding

# The rate that `compress` states: with it a decoder can start every 1000 frames.
_NOMINAL_HZ = 100.0

# From time lapse to ballistics, as `mocapd import` takes them.
_RATES_HZ = (0.001, 1e6)

# Most samples that are given at once: 12 GiB. A few bytes of a damaged take can claim years of lost frames.
SAMPLES_MAX = 1 << 30

_UP_AXES = {None: 0, "x": 1, "y": 2, "z": 3}


def threads_of(threads: int | None) -> int:
    """How many threads to use: as many as are asked for, else one a core, at most 8."""
    if threads is None:
        return min(8, os.cpu_count() or 1)
    if threads < 1:
        raise ValueError(f"{threads} threads: at least one has to do the work")
    return threads


def _positions(array: npt.ArrayLike) -> npt.NDArray[np.float32]:
    positions = np.asarray(array)
    if positions.ndim != 3 or positions.shape[2] != 3:
        hint = ": for one marker pass array[:, np.newaxis, :]" if positions.ndim == 2 else ""
        raise ValueError(f"an array of shape {positions.shape} is not [frames, markers, 3]{hint}")
    if positions.dtype.kind not in "fiu":
        raise ValueError(f"an array of {positions.dtype} has no positions: float32 millimetres are what is kept")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(positions, dtype=np.float32)


def _tolerance(tolerance_mm: float | None, resampler: str) -> float | None:
    if resampler == "lossless":
        return None
    if tolerance_mm is None or not tolerance_mm > 0:
        raise ValueError(
            f"a tolerance of {tolerance_mm} mm: give a distance such as 0.5, or resampler='lossless' for every bit"
        )
    return float(tolerance_mm)


def compress(
    array: npt.ArrayLike,
    tolerance_mm: float | None,
    resampler: str = "dense",
    *,
    threads: int | None = None,
) -> bytes:
    """Codes positions so that each comes back within a distance of what it was.

    Parameters
    ----------
    array
        [frames, markers, 3], in millimetres; a gap is three NaN. Anything but float32 is rounded to float32
        first, and the bound is from there.
    tolerance_mm
        The largest Euclidean distance in 3D between a sample and what :func:`decompress` gives. The encoder
        rebuilds and measures every sample.
    resampler
        ``dense`` (smallest), ``fast``, ``lossless`` (every bit; the tolerance is not used), or ``spline`` and
        ``sync``, the published methods, for short arrays.
    threads
        One a core, at most 8, unless given; the bytes are the same for any number.

    Returns
    -------
    bytes
        A whole take, of markers without names at 100 frames a second: written to a file, whatever reads takes
        reads it.

    Raises
    ------
    ValueError
        For another shape, a position that is half a gap or infinite, or a tolerance out of range.
    """
    positions = _positions(array)
    labels = [(f"u{column + 1:03}", False) for column in range(positions.shape[1])]
    tolerance = _tolerance(tolerance_mm, resampler)
    return encode(positions, labels, _coding(_NOMINAL_HZ, tolerance, resampler, None), threads_of(threads))


def decompress(data: bytes, *, threads: int | None = None) -> npt.NDArray[np.float32]:
    """Gives back what :func:`compress` was given: float32 [frames, markers, 3], in millimetres, NaN where it was.

    Any take's bytes will do.

    Raises
    ------
    TakeError
        For bytes that are no take, or that are damaged or cut off: nothing of them is given then; and for a take
        of more than 2^30 samples, which :func:`mocapd.open` reads in parts.
        :func:`mocapd.open` reads as much of a damaged file as can be.
    """
    take = TakeFile.from_bytes(bytes(data))
    columns = list(range(len(take.labels)))
    problems = take.problems + [take.cut_off] * (take.cut_off is not None)
    if take.n_rows * max(len(columns), 1) > SAMPLES_MAX:
        raise TakeError(f"{take.n_rows} frames of {len(columns)} markers are more than fit at once: write the bytes to a file")
    if not problems:
        out = np.empty((take.n_rows, len(columns), 3), dtype=np.float32)
        problems = take.read_into(out, 0, columns, threads_of(threads))
    if problems:
        raise TakeError(f"the bytes are damaged: {problems[0]}")
    return out


def write_take(
    path: str | os.PathLike[str],
    positions: npt.ArrayLike,
    labels: Sequence[str],
    rate_hz: float,
    tolerance_mm: float | None = 0.5,
    resampler: str = "dense",
    *,
    up_axis: str | None = None,
    threads: int | None = None,
) -> int:
    """Writes positions as a take. Gives its size in bytes.

    The file has its name when it is complete, and no file is ever overwritten.

    Parameters
    ----------
    path
        The file; it must not exist.
    positions
        [frames, markers, 3], in millimetres; a gap is three NaN.
    labels
        A name a marker; an empty one is a marker without a name.
    rate_hz
        Frames a second.
    tolerance_mm, resampler, threads
        As for :func:`compress`.
    up_axis
        ``x``, ``y`` or ``z``, where it is known.

    Raises
    ------
    FileExistsError
        When there is such a file.
    ValueError
        As for :func:`compress`; for another number of labels than markers, or a rate that is none.
    """
    array = _positions(positions)
    labels = list(labels)
    if len(labels) != array.shape[1]:
        raise ValueError(f"{len(labels)} labels for {array.shape[1]} markers: give one a marker")
    if up_axis not in _UP_AXES:
        raise ValueError(f"up_axis={up_axis!r}: use 'x', 'y', 'z' or None")
    slowest_hz, fastest_hz = _RATES_HZ
    if not slowest_hz <= rate_hz <= fastest_hz:
        raise ValueError(f"a rate of {rate_hz} Hz: a take runs at {slowest_hz:g} to {fastest_hz:g} Hz")
    named = [(label or f"u{column + 1:03}", bool(label)) for column, label in enumerate(labels)]
    tolerance = _tolerance(tolerance_mm, resampler)
    to = Path(path)
    if to.exists():
        raise FileExistsError(17, "takes are never overwritten: choose another name", str(to))
    take = encode(array, named, _coding(float(rate_hz), tolerance, resampler, up_axis), threads_of(threads))
    _put(to, take)
    return len(take)


def _coding(rate_hz: float, tolerance_mm: float | None, resampler: str, up_axis: str | None) -> Coding:
    """How a take is coded, as the native module takes it."""
    return {"rate_hz": rate_hz, "tolerance_mm": tolerance_mm, "resampler": resampler, "up_axis": _UP_AXES[up_axis]}


def _put(to: Path, data: bytes) -> None:
    """A file of its own, synced, that then gets the name, unless somebody has it by now."""
    temporary = to.with_name(f".{to.name}.{secrets.token_hex(4)}")
    try:
        with open(temporary, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.link(temporary, to)
    finally:
        temporary.unlink(missing_ok=True)
