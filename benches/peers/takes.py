"""Reads a take for the bench: positions in millimetres as float32, with filled gaps for codecs without gaps.

The readers are those of `tests/oracle`, which share no code with mocapd.
"""

import hashlib
import sys
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "oracle"))
import readers  # noqa: E402

SUFFIXES = {".c3d", ".trc", ".tsv", ".csv"}

# Takes that were low-pass filtered until almost no sensor noise was left. They compress far better than recorded data,
# so they are listed but excluded from every summary.
FILTERED = ("two_vertical_jumps_51p", "walk_159p")


@dataclass
class BenchTake:
    """One recorded take; `positions_mm` is float32 (frames, markers, 3), NaN where a sample is missing."""

    name: str
    path: Path
    sha256: str
    rate_hz: float
    positions_mm: np.ndarray
    gaps: str = "linear"  # how `filled` fills gaps: "linear", or "held" (with the last position before the gap)

    @property
    def fills(self):
        """The take with each method of gap filling; only itself when it has no gaps."""
        return [self] if self.present.all() else [replace(self, gaps=gaps) for gaps in ("linear", "held")]

    @property
    def shape(self):
        return self.positions_mm.shape

    @cached_property
    def present(self):
        """(frames, markers): whether the sample was recorded."""
        return ~np.isnan(self.positions_mm[:, :, 0])

    @property
    def samples(self):
        return int(self.present.sum())

    @property
    def raw_bytes(self):
        """Three float32 for each sample that is present; missing samples do not count."""
        return 12 * self.samples

    @property
    def filtered(self):
        return self.name.startswith(FILTERED)

    @cached_property
    def filled(self):
        """Float32 (markers * 3, frames), C order, one channel per row. Gaps at both ends hold the nearest position;
        markers without samples are 0."""
        return fill(self.positions_mm, self.present, self.gaps)


def fill(positions_mm, present, gaps):
    """Fills gaps: linear interpolation suits the scientific codecs; a held position has zero differences, which suits
    the quantising ones."""
    frames = np.arange(len(positions_mm))
    channels = np.ascontiguousarray(positions_mm.transpose(1, 2, 0))
    for marker, here in enumerate(present.T):
        if not here.any():
            channels[marker] = 0.0
        elif not here.all():
            known = np.flatnonzero(here)
            if gaps == "held":
                last = np.searchsorted(known, frames, side="right") - 1
                channels[marker] = channels[marker][:, known[np.maximum(last, 0)]]
                continue
            for axis in range(3):
                channels[marker, axis] = np.interp(frames, known, channels[marker, axis, known])
    return channels.reshape(-1, len(positions_mm))


def max_error_mm(take, channels):
    """Largest Euclidean distance over the samples present, computed in float64; `channels` has the layout of `filled`
    and any dtype. It is rounded to float32 first, the type that a reader receives.
    """
    frames, markers, _ = take.shape
    decoded = channels.astype(np.float32).reshape(markers, 3, frames).transpose(2, 0, 1)
    difference = decoded[take.present].astype(np.float64) - take.positions_mm[take.present]
    if not np.isfinite(difference).all():
        return float("inf")
    return float(np.sqrt((difference**2).sum(axis=1)).max())


def load(path):
    path = Path(path)
    take = readers.read(path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return BenchTake(path.stem, path, digest, take.rate_hz, take.positions_mm)


def find(folder):
    return sorted(p for p in Path(folder).iterdir() if p.suffix.lower() in SUFFIXES)
