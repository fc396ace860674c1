"""Force plates of an imported C3D file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ._analog import AnalogChannel, Values
from ._ranges import check_size

if TYPE_CHECKING:
    from ._take import Take

# Force, moment, centre of pressure and free moment, three axes each.
_COLUMNS = 12


@dataclass(frozen=True)
class PlateLoads:
    """The loads on a force plate, in the laboratory's axes: arrays with a row for each analog sample.

    Of a plate whose loads cannot be computed, all are NaN; :attr:`ForcePlate.problem` says why.
    """

    time_s: Values
    """Seconds from the first frame: [samples]."""
    force_n: Values
    """The force, in newtons: [samples, 3]."""
    moment_nm: Values
    """The moment about the centre of the plate's surface, in newton metres: [samples, 3]."""
    cop_mm: Values
    """The centre of pressure on the plate's surface, in millimetres: [samples, 3]; NaN for an unloaded plate."""
    free_moment_nm: Values
    """The moment about the centre of pressure, in newton metres: [samples, 3]; NaN where that is NaN."""


class ForcePlate:
    """A force plate."""

    def __init__(
        self,
        take: Take,
        number: int,
        *,
        type: int,
        corners_mm: npt.NDArray[np.float64],
        origin_mm: npt.NDArray[np.float64],
        channels: list[int],
        calibration: npt.NDArray[np.float64] | None,
        problem: str | None,
    ) -> None:
        self._take = take
        self.number = number
        """Its number in the file, from 1."""
        self.type = type
        """The type of its output as the C3D format defines it: 1 to 4, or another number."""
        self.corners_mm = corners_mm
        """Its corners in the laboratory: float64 [4, 3], in the plate's quadrants +x +y, -x +y, -x -y, +x -y. NaN if
        the file does not state them."""
        self.origin_mm = origin_mm
        """ORIGIN of the C3D file, float64 [3]. Types 2 and 4: from the origin of the plate's axes to the centre of its
        surface, in the plate's axes. Type 1: only z counts. Type 3: distances of the sensors from the centre in x
        and y, and z."""
        self.channels: tuple[AnalogChannel, ...] = tuple(take.analog.channels[index] for index in channels)
        """Its analog channels, in the order that its type defines."""
        self.calibration = calibration
        """The calibration matrix, float64 [6, 6]; None if the file has none."""
        self.problem = problem
        """Why its loads cannot be computed; None if they can."""

    def __repr__(self) -> str:
        return f"<mocapd.ForcePlate {self.number} of {self._take.path!r}: type {self.type}>"

    def read(self, start_s: float | None = None, stop_s: float | None = None) -> PlateLoads:
        """The loads from ``start_s`` to before ``stop_s``, in seconds from the first frame.

        Raises
        ------
        TakeError
            If the samples are damaged.
        ValueError
            For a negative time or NaN, an end before the start, too many samples, or a take that is closed.
        """
        analog = self._take.analog
        first, stop = analog._range(start_s, stop_s)
        check_size(stop - first, _COLUMNS, "samples of a force plate")
        out = np.full((stop - first, _COLUMNS), np.nan)
        if self.problem is None:
            self._take._file.read_force_plate(out, first, self.number - 1)
        else:
            self._take._warn([f"force plate {self.number}: {self.problem}"])
        force, moment, cop, free = (out[:, column : column + 3] for column in range(0, _COLUMNS, 3))
        return PlateLoads(analog._times(first, stop), force, moment, cop, free)

    @cached_property
    def loads(self) -> PlateLoads:
        """All loads. Computed once and cached, 104 bytes per analog sample; :meth:`read` computes a part."""
        return self.read()

    @property
    def force_n(self) -> Values:
        """The force in newtons, in the laboratory's axes: [samples, 3]."""
        return self.loads.force_n

    @property
    def moment_nm(self) -> Values:
        """The moment about the centre of the plate's surface, in newton metres: [samples, 3]."""
        return self.loads.moment_nm

    @property
    def cop_mm(self) -> Values:
        """The centre of pressure, in millimetres: [samples, 3]; NaN for an unloaded plate."""
        return self.loads.cop_mm

    @property
    def free_moment_nm(self) -> Values:
        """The moment about the centre of pressure, in newton metres: [samples, 3]."""
        return self.loads.free_moment_nm

    @property
    def time_s(self) -> Values:
        """The times of the analog samples, in seconds from the first frame."""
        return self._take.analog.time_s
