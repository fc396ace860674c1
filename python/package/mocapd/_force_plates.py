"""Force plates of an imported C3D file, or of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ._analog import Analog, AnalogChannel, Values
from ._ranges import check_size

# Force, moment, centre of pressure and free moment, three axes each.
_LOAD_VALUES = 12


@dataclass(frozen=True)
class PlateLoads:
    """The loads of a force plate, in the laboratory's axes: arrays with a row for each sample of its channels, NaN where
    the file has none, or the recording lost some.

    They are the reactions of the plate on the subject: standing on a plate gives a force that points up.
    """

    time_s: Values
    """Seconds from the first frame: [samples]."""
    force_n: Values
    """The force, in newtons: [samples, 3]."""
    moment_nm: Values
    """The moment about the centre of the plate's surface, in newton metres: [samples, 3]."""
    cop_mm: Values
    """The centre of pressure on the plate's surface, in millimetres: [samples, 3]; NaN if the force normal to the plate
    is below 20 N."""
    free_moment_nm: Values
    """The moment about the centre of pressure, which is normal to the plate, in newton metres: [samples, 3]; NaN without
    a centre of pressure."""


class ForcePlate:
    """A force plate."""

    def __init__(
        self,
        analog: Analog,
        index: int,
        path: str,
        *,
        number: int,
        type: int,
        corners_mm: npt.NDArray[np.float64],
        origin_mm: npt.NDArray[np.float64],
        channels: list[int],
        calibration: npt.NDArray[np.float64] | None,
    ) -> None:
        self._analog = analog
        self._index = index
        self._path = path
        self.number = number
        """Its number in the file, from 1."""
        self.type = type
        """The type of its output as the C3D format defines it, 1 to 4."""
        self.corners_mm = corners_mm
        """Its corners in the laboratory, in millimetres: float64 [4, 3]. In the plate's own axes they are in the
        quadrants +x +y, -x +y, -x -y, +x -y."""
        self.origin_mm = origin_mm
        """FORCE_PLATFORM:ORIGIN in the plate's own axes, in millimetres: float64 [3]. For types 2 and 4 it leads from the
        origin of the sensors to the centre of the surface; for type 3, x and y are half the distances of the sensors, and
        z is the height of their origin above the surface."""
        self.channels: tuple[AnalogChannel, ...] = tuple(analog.channels[channel] for channel in channels)
        """Its analog channels, in the order that its type defines: six, or eight for type 3."""
        self.calibration = calibration
        """For type 4: the matrix that turns its channels into newtons and newton metres, float64 [6, 6]."""

    def __repr__(self) -> str:
        return f"<mocapd.ForcePlate {self.number} of {self._path!r}: type {self.type}>"

    def read(self, start_s: float | None = None, stop_s: float | None = None) -> PlateLoads:
        """The loads from ``start_s`` to before ``stop_s``, in seconds from the first frame.

        Raises
        ------
        TakeError
            If the samples are damaged.
        ValueError
            For a negative time or NaN, an end before the start, too many samples, or a take that is closed.
        """
        return read_loads([self], start_s, stop_s)[0]

    @cached_property
    def loads(self) -> PlateLoads:
        """All loads. Computed once and cached, 104 bytes per sample; :meth:`read` computes a part."""
        return self.read()

    @property
    def force_n(self) -> Values:
        """All forces, in newtons, in the laboratory's axes: [samples, 3]."""
        return self.loads.force_n

    @property
    def moment_nm(self) -> Values:
        """All moments about the centre of the plate's surface, in newton metres: [samples, 3]."""
        return self.loads.moment_nm

    @property
    def cop_mm(self) -> Values:
        """All centres of pressure, in millimetres: [samples, 3]; NaN if the normal force is below 20 N."""
        return self.loads.cop_mm

    @property
    def free_moment_nm(self) -> Values:
        """All moments about the centre of pressure, in newton metres: [samples, 3]."""
        return self.loads.free_moment_nm

    @property
    def time_s(self) -> Values:
        """The times of the samples, in seconds from the first frame."""
        return self._analog.time_s


def read_loads(plates: Sequence[ForcePlate], start_s: float | None, stop_s: float | None) -> list[PlateLoads]:
    """The loads of several plates whose channels are sampled together, which are decoded once."""
    if not plates:
        return []
    analog = plates[0]._analog
    first, stop = analog._range(start_s, stop_s)
    width = _LOAD_VALUES * len(plates)
    check_size(stop - first, width, f"samples of {len(plates)} force plates")
    out = np.empty((stop - first, width))
    analog._read_loads(out, first, [plate._index for plate in plates])
    time_s = analog._times(first, stop)
    return [PlateLoads(time_s, *np.split(loads, 4, axis=1)) for loads in np.split(out, len(plates), axis=1)]
