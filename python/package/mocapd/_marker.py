"""One marker of a take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Union

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from ._take import Take

Positions = npt.NDArray[np.float32]
MarkerKey = Union[str, int]
Markers = Union[Sequence[MarkerKey], MarkerKey, None]


@dataclass(frozen=True)
class MarkerSummary:
    """The counts of one marker over a whole take."""

    label: str
    n_samples: int
    n_gaps: int
    """Runs of consecutive frames without a sample, including those at start and end."""
    n_knots: int
    """Kept samples; the others are interpolated between them."""
    max_error_mm: float
    """The largest error that the take states for blocks with samples of this marker."""


class Marker:
    """One marker of a take; ``marker[100:200]`` are its positions in frames 100 to 199, [frames, 3]."""

    def __init__(self, take: Take, column: int) -> None:
        self.take = take
        self.column = column
        self.label: str = take.labels[column]

    def __repr__(self) -> str:
        return f"<mocapd.Marker {self.label!r} of {self.take.path!r}>"

    @cached_property
    def positions(self) -> Positions:
        """All positions of the marker: float32 [frames, 3], millimetres, NaN for missing samples."""
        return self.read()

    def read(self, start_s: float | None = None, stop_s: float | None = None) -> Positions:
        """Positions of the marker from ``start_s`` to before ``stop_s``: float32 [frames, 3], millimetres."""
        return self.take.read(start_s, stop_s, self.column)[:, 0]

    def __getitem__(self, frames: slice) -> Positions:
        found = self.take[frames, self.column]
        assert isinstance(found, np.ndarray)
        return found

    @cached_property
    def knots(self) -> npt.NDArray[np.int64]:
        """The frames of the kept samples; the other samples are interpolated between them."""
        return self.take.knots(self.column)[0]

    @property
    def n_knots(self) -> int:
        """Number of kept samples."""
        return len(self.knots)

    @property
    def knot_times_s(self) -> npt.NDArray[np.float64]:
        """The times of the kept samples, in seconds from the first frame."""
        return self.knots / self.take.rate_hz

    @property
    def max_error_mm(self) -> float:
        """The largest error that the take states for blocks with samples of this marker."""
        return list(self.take.summary.values())[self.column].max_error_mm
