"""Encoding arrays as takes, and decoding them."""

from __future__ import annotations

import os
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ._native import TakeError, TakeFile, encode
from ._ranges import SAMPLES_MAX

if TYPE_CHECKING:
    from ._native import EncodeOptions

# The nominal rate of `compress`: it gives a key stretch every 1000 frames, where decoding can start.
_NOMINAL_HZ = 100.0

# From time lapse to ballistics; `mocapd import` has the same limits.
_RATES_HZ = (0.001, 1e6)

_UP_AXES = {None: 0, "x": 1, "y": 2, "z": 3}


def thread_count(threads: int | None) -> int:
    """The number of threads to use: as requested, otherwise one for each core, at most 8."""
    if threads is None:
        return min(8, os.cpu_count() or 1)
    if threads < 1:
        raise ValueError(f"threads={threads}: use at least 1, or None for one for each core")
    return threads


def _positions(array: npt.ArrayLike) -> npt.NDArray[np.float32]:
    positions = np.asarray(array)
    if positions.ndim != 3 or positions.shape[2] != 3:
        hint = ": for one marker use array[:, np.newaxis, :]" if positions.ndim == 2 else ""
        raise ValueError(f"expected an array [frames, markers, 3], found shape {positions.shape}{hint}")
    if positions.dtype.kind not in "fiu":
        raise ValueError(f"expected an array of numbers such as float32 millimetres, found {positions.dtype}")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(positions, dtype=np.float32)


def _tolerance(tolerance_mm: float | None, resampler: str) -> float | None:
    if resampler.partition(":")[0] == "lossless":
        return None
    if tolerance_mm is None or not tolerance_mm > 0:
        raise ValueError(
            f"tolerance_mm={tolerance_mm}: use a distance above 0, or resampler='lossless' to keep every bit"
        )
    return float(tolerance_mm)


def compress(
    array: npt.ArrayLike,
    tolerance_mm: float | None,
    resampler: str = "dense",
    *,
    threads: int | None = None,
) -> bytes:
    """Compresses positions with a bounded error.

    Parameters
    ----------
    array
        [frames, markers, 3], in millimetres; a gap is three NaN. Other types are rounded to float32 first, and
        the error is measured from the rounded values.
    tolerance_mm
        The largest allowed Euclidean distance in 3D between a sample and its reconstruction by :func:`decompress`.
        The encoder decodes and verifies every sample.
    resampler
        ``dense`` (smallest), ``fast``, ``lossless:predictive`` (every bit; ignores the tolerance), ``lossless`` (the
        same, faster and larger), or for short arrays one of the published methods ``spline`` and ``sync``.
    threads
        Number of threads; by default one for each core, at most 8. The result does not depend on it.

    Returns
    -------
    bytes
        A complete take of unlabelled markers at 100 frames a second, which any program that reads takes can read
        from a file.

    Raises
    ------
    ValueError
        If the array has another shape, a position is infinite or only partly NaN, or the tolerance is out of range.
    """
    positions = _positions(array)
    labels = [(f"u{column + 1:03}", False) for column in range(positions.shape[1])]
    tolerance = _tolerance(tolerance_mm, resampler)
    return encode(positions, labels, _encode_options(_NOMINAL_HZ, tolerance, resampler, None), thread_count(threads))


def decompress(data: bytes, *, threads: int | None = None) -> npt.NDArray[np.float32]:
    """Decompresses the result of :func:`compress`: float32 [frames, markers, 3], in millimetres, NaN for gaps.

    Accepts the bytes of any take.

    Raises
    ------
    TakeError
        If the bytes are not a complete, undamaged take, or the take has more than 2^30 samples. To read the intact
        part of a damaged take, or a large take in parts, use :func:`mocapd.open`.
    """
    take = TakeFile.from_bytes(bytes(data))
    columns = list(range(len(take.labels)))
    problems = take.problems + [take.cut_off] * (take.cut_off is not None)
    if take.n_rows * max(len(columns), 1) > SAMPLES_MAX:
        raise TakeError(
            f"{take.n_rows} frames of {len(columns)} markers are too many for one array: write the bytes to a file, "
            "and read it in parts with mocapd.open"
        )
    if not problems:
        out = np.empty((take.n_rows, len(columns), 3), dtype=np.float32)
        problems = take.read_into(out, 0, columns, thread_count(threads))
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
    """Writes positions as a take. Returns its size in bytes.

    The file appears under its name once it is complete. Never overwrites a file.

    Parameters
    ----------
    path
        The new file.
    positions
        [frames, markers, 3], in millimetres; a gap is three NaN.
    labels
        One label for each marker; empty for an unlabelled marker.
    rate_hz
        Frames a second, 0.001 to 10^6.
    tolerance_mm, resampler, threads
        See :func:`compress`.
    up_axis
        ``x``, ``y`` or ``z``, or None if unknown.

    Raises
    ------
    FileExistsError
        If the file exists.
    ValueError
        For arguments that :func:`compress` rejects, a number of labels other than that of markers, or an invalid
        rate or up axis.
    """
    array = _positions(positions)
    labels = list(labels)
    if len(labels) != array.shape[1]:
        raise ValueError(f"{len(labels)} labels for {array.shape[1]} markers: give one for each marker")
    if up_axis not in _UP_AXES:
        raise ValueError(f"up_axis={up_axis!r}: use 'x', 'y', 'z' or None")
    slowest_hz, fastest_hz = _RATES_HZ
    if not slowest_hz <= rate_hz <= fastest_hz:
        raise ValueError(f"expected a rate of {slowest_hz:g} to {fastest_hz:g} Hz, found {rate_hz} Hz")
    named = [(label or f"u{column + 1:03}", bool(label)) for column, label in enumerate(labels)]
    tolerance = _tolerance(tolerance_mm, resampler)
    to = Path(path)
    if to.exists():
        raise FileExistsError(17, "the file exists and is not overwritten: choose another name", str(to))
    take = encode(array, named, _encode_options(float(rate_hz), tolerance, resampler, up_axis), thread_count(threads))
    _write_new_file(to, take)
    return len(take)


def _encode_options(rate_hz: float, tolerance_mm: float | None, resampler: str, up_axis: str | None) -> EncodeOptions:
    """The encoder's options for the native module."""
    return {"rate_hz": rate_hz, "tolerance_mm": tolerance_mm, "resampler": resampler, "up_axis": _UP_AXES[up_axis]}


def _write_new_file(to: Path, data: bytes) -> None:
    """Writes and syncs a temporary file, then links it to the name unless that exists by now."""
    temporary = to.with_name(f".{to.name}.{secrets.token_hex(4)}")
    try:
        with open(temporary, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.link(temporary, to)
    finally:
        temporary.unlink(missing_ok=True)
