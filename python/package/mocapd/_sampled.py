"""Groups of sampled channels of a recording."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ._analog import Analog, Values
from ._ranges import check_order, check_size

if TYPE_CHECKING:
    from ._native import SampledFields, TakeFile


class SampledGroup(Analog):
    """Channels that a device sampled together, at a rate of their own: force plates, electrodes, inertial sensors.

    It is read like the analog channels of an import: ``group["Fz1"].values``, ``group.read(start_s, stop_s)``. Each sample
    has a time of its own, on the time line of the frames: one that was taken with a frame has the time of that frame.
    Samples may begin before the first frame, at negative times. Values are float32, NaN where samples are lost.
    """

    def __init__(self, file: TakeFile, index: int, found: SampledFields) -> None:
        super().__init__(file, {**found, "warnings": []})
        self._index_in_take = index
        self.number: int = found["number"]
        """Its number at the device."""

    def __repr__(self) -> str:
        return f"<mocapd.SampledGroup {self.number}: {len(self)} channels of {self.n_samples} samples at {self.rate_hz:g} Hz>"

    @property
    def duration_s(self) -> float:
        """From the first sample to the last one, and a period more, in seconds."""
        time_s = self.time_s
        return float(time_s[-1] - time_s[0]) + 1 / self.rate_hz if len(time_s) else 0.0

    @cached_property
    def time_s(self) -> Values:  # type: ignore[override]
        """The times of all samples, in seconds from the first frame: float64 [samples]."""
        return self._file.sampled_times(self._index_in_take)

    def _range(self, start_s: float | None, stop_s: float | None) -> tuple[int, int]:
        check_order(start_s, stop_s)
        ends = (0, self.n_samples)
        for time_s in (start_s, stop_s):
            if time_s is not None and np.isnan(time_s):
                raise ValueError("time nan s: times are seconds from the first frame")
        first, stop = (
            end if time_s is None else int(np.searchsorted(self.time_s, time_s)) for time_s, end in zip((start_s, stop_s), ends)
        )
        return first, max(first, stop)

    def _times(self, first: int, stop: int) -> Values:
        return self.time_s[first:stop]

    def _read(self, first: int, stop: int, indices: list[int]) -> npt.NDArray[np.float32]:  # type: ignore[override]
        check_size(stop - first, len(indices), f"samples of {len(indices)} channels")
        if "values" in self.__dict__ and not self._file.closed:
            return self.values[first:stop, indices]  # type: ignore[return-value]
        out = np.empty((stop - first, len(indices)), dtype=np.float32)
        self._file.read_sampled(out, self._index_in_take, first, indices)
        return out

    def _read_loads(self, out: Values, first: int, plates: list[int]) -> None:
        self._file.read_sampled_loads(out, self._index_in_take, first, plates)
