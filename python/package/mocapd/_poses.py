"""Poses of the rigid bodies of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Union

import numpy as np
import numpy.typing as npt

from ._ranges import check_order, check_size, index_range

if TYPE_CHECKING:
    from ._native import TakeFile

BodyKey = Union[str, int]
Bodies = Union[Sequence[BodyKey], BodyKey, None]


@dataclass(frozen=True)
class PoseArrays:
    """Poses of some bodies in some frames."""

    frame: npt.NDArray[np.int64]
    """The indices of the frames, from 0: [frames]."""
    time_s: npt.NDArray[np.float64]
    """Their times, in seconds from the first frame: [frames]."""
    positions_mm: npt.NDArray[np.float32]
    """Positions of the bodies' origins in millimetres: [frames, bodies, 3]; NaN where a body has no pose."""
    quaternions: npt.NDArray[np.float32]
    """Rotations from the body's axes to those of the positions: [frames, bodies, 4], w, x, y, z; NaN where a body has no
    pose."""
    residuals_mm: npt.NDArray[np.float32]
    """How well the bodies' markers fit, in millimetres: [frames, bodies]; NaN where it is not known."""
    states: npt.NDArray[np.uint8]
    """The keys of :attr:`Poses.STATES`, 0 where a body has a pose: [frames, bodies]."""


class Poses:
    """The poses of the rigid bodies of a recording: a position and a rotation of each in each frame.

    ``len(take.poses)`` is the number of bodies; :meth:`read` reads some or all. A point p of a body is at
    ``position + q p q*``.
    """

    STATES = {
        0: "tracked",
        1: "lost",
        2: "rejected",
        3: "other",
        253: "missing",
        254: "refused",
        255: "unlisted",
    }
    """Why a body has no pose in a frame: the device did not see enough of it, did not vouch for the pose, or gave another
    reason; the take has no poses for the frame; the device had announced another body; or it did not list this one."""

    def __init__(self, file: TakeFile, n_frames: int, rate_hz: float) -> None:
        self._file = file
        bodies = file.bodies()
        self.names: tuple[str, ...] = tuple(name for _, name in bodies)
        """The names of the bodies."""
        self.numbers: tuple[int, ...] = tuple(number for number, _ in bodies)
        """Their numbers, as the driver gave them."""
        self.n_frames = n_frames
        """Frames of the take."""
        self.rate_hz = rate_hz
        """Frames a second."""

    def __repr__(self) -> str:
        return f"<mocapd.Poses: {len(self)} bodies in {self.n_frames} frames at {self.rate_hz:g} Hz>"

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    @cached_property
    def _all(self) -> PoseArrays:
        return self._read(0, self.n_frames, list(range(len(self))))

    @property
    def positions(self) -> npt.NDArray[np.float32]:
        """Positions in all frames: float32 [frames, bodies, 3], millimetres, NaN where a body has no pose.

        This and the next three are decoded once and cached, 33 bytes per pose; :meth:`read` decodes a part.
        """
        return self._all.positions_mm

    @property
    def quaternions(self) -> npt.NDArray[np.float32]:
        """Rotations in all frames: float32 [frames, bodies, 4], w, x, y, z, NaN where a body has no pose."""
        return self._all.quaternions

    @property
    def residuals(self) -> npt.NDArray[np.float32]:
        """Residuals in all frames: float32 [frames, bodies], millimetres, NaN where they are not known."""
        return self._all.residuals_mm

    @property
    def states(self) -> npt.NDArray[np.uint8]:
        """States in all frames: uint8 [frames, bodies], keys of :attr:`STATES`."""
        return self._all.states

    def read(
        self,
        start_s: float | None = None,
        stop_s: float | None = None,
        bodies: Bodies = None,
        *,
        start_frame: int | None = None,
        stop_frame: int | None = None,
    ) -> PoseArrays:
        """Reads a part. Only the necessary part of the file is decoded.

        Parameters
        ----------
        start_s, stop_s
            Seconds from the first frame: reads frames at or after ``start_s`` and before ``stop_s``.
        bodies
            Names or indices, in the order of the result; by default all.
        start_frame, stop_frame
            The range as frame indices from 0, instead of seconds.

        Raises
        ------
        KeyError
            If a body is not in the take.
        ValueError
            For a negative time or NaN, an end before the start, more than 2^27 poses, or a take that is closed.
        """
        first, stop = self._range(start_s, stop_s, start_frame, stop_frame)
        return self._read(first, stop, self._indices(bodies))

    def _range(
        self, start_s: float | None, stop_s: float | None, start_frame: int | None, stop_frame: int | None
    ) -> tuple[int, int]:
        if start_frame is None and stop_frame is None:
            return index_range(start_s, stop_s, self.rate_hz, self.n_frames)
        if start_s is not None or stop_s is not None:
            raise ValueError("give a range in seconds or in frames, not both")
        if min(start_frame or 0, stop_frame or 0) < 0:
            raise ValueError("frames count from 0")
        check_order(start_frame, stop_frame)
        first = min(start_frame or 0, self.n_frames)
        return first, self.n_frames if stop_frame is None else min(stop_frame, self.n_frames)

    def _read(self, first: int, stop: int, indices: list[int]) -> PoseArrays:
        check_size(stop - first, 8 * len(indices), f"frames of {len(indices)} bodies")
        frame = np.arange(first, stop)
        numbers = np.full((stop - first, len(indices), 8), np.nan, dtype=np.float32)
        states = np.full(numbers.shape[:2], 253, dtype=np.uint8)
        self._file.read_poses(numbers, states, first, indices)
        return PoseArrays(
            frame=frame,
            time_s=frame / self.rate_hz,
            positions_mm=numbers[:, :, :3],
            quaternions=numbers[:, :, 3:7],
            residuals_mm=numbers[:, :, 7],
            states=states,
        )

    def _indices(self, bodies: Bodies) -> list[int]:
        if bodies is None:
            return list(range(len(self)))
        if isinstance(bodies, (str, int, np.integer)):
            bodies = [bodies]
        return [self._index(body) for body in bodies]

    def _index(self, key: BodyKey) -> int:
        if isinstance(key, (int, np.integer)):
            if not 0 <= key < len(self):
                raise KeyError(f"no body {key}: the take has {len(self)} rigid bodies, counted from 0")
            return int(key)
        found = [index for index, name in enumerate(self.names) if name == key]
        if len(found) == 1:
            return found[0]
        if found:
            raise KeyError(f"{len(found)} bodies have the name {key!r}: use one of their indices, {found}")
        names = ", ".join(self.names[:20]) + ("..." if len(self) > 20 else "")
        raise KeyError(f"no rigid body has the name {key!r}; the names are {names or 'none'}")
