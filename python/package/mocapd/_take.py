"""An open take and its markers."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from functools import cached_property
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
import numpy.typing as npt

from . import _tables
from ._analog import Analog
from ._arrays import thread_count
from ._force_plates import ForcePlate
from ._marker import Marker, MarkerKey, Markers, MarkerSummary, Positions
from ._native import TakeFile
from ._parameters import Metadata, metadata
from ._ranges import check_order, check_size, index_at, unique_names
from ._records import ClockLine, Ending, Event, Header, Ledger, LostFrames, Times
from ._poses import Bodies, Poses
from ._sampled import SampledGroup
from ._subject import Subject

if TYPE_CHECKING:
    import pandas
    import xarray

# The times of a frame take as much memory as this number of samples.
_TIMES_AS_SAMPLES = 4


class TakeWarning(UserWarning):
    """Part of a take is missing or damaged, or can be read in several ways; the message says which."""


def open(path: str | os.PathLike[str], *, threads: int | None = None) -> Take:
    """Opens a take.

    Decodes nothing yet, and reads little of a complete take, whatever its length. A take that was cut off, for
    example by a crash of the recorder, opens with a :class:`TakeWarning` about the missing part.

    ``with mocapd.open(path) as take:`` closes the file at the end of the block.

    Parameters
    ----------
    path
        The file.
    threads
        Number of threads for decoding; by default one for each core, at most 8.

    Raises
    ------
    FileNotFoundError, PermissionError, OSError
        If the file cannot be read.
    TakeError
        If the file is not a take, has another version, or has a damaged header.
    """
    return Take(path, threads=threads)


class Take:
    """An open take: marker trajectories, frame times, events and the ledger; for an import also its analog channels,
    force plates and parameters.

    It holds the file open until it is closed: by :meth:`close`, at the end of a ``with`` block, or when nothing refers
    to it any more.

    ``take[100:200]`` are the positions of frames 100 to 199, [frames, markers, 3]; ``take["LKNE"]`` is a marker;
    ``take[100:200, "LKNE"]`` are the positions of that marker, [frames, 3].
    """

    def __init__(self, path: str | os.PathLike[str], *, threads: int | None = None) -> None:
        self.path = os.fspath(path)
        self._threads = thread_count(threads)
        self._file = TakeFile(path)
        self.header: Header = Header._of(self._file.header())
        """The header: device or source, resampler, tolerance, writer."""
        self.labels: tuple[str, ...] = tuple(self._file.labels)
        """The marker labels, in order of columns; ``u001``... for unlabelled markers."""
        self.n_frames: int = self._file.n_rows
        """Number of frames, including lost ones."""
        self.finished: bool = self._file.finished
        """Whether the take is complete; otherwise it was cut off."""
        self.problems: list[str] = []
        """What is missing or damaged in the part read so far, and what the imported file leaves open."""
        self._warn(self._file.problems)
        if self._file.cut_off is not None:
            self._warn_cut_off(self._file.cut_off)

    # -- description ---------------------------------------------------------------------------------------

    @property
    def frames(self) -> int:
        """Number of frames, including lost ones: ``n_frames``."""
        return self.n_frames

    @property
    def n_markers(self) -> int:
        """Number of markers, including those that were never seen."""
        return len(self.labels)

    @property
    def rate_hz(self) -> float:
        """Frames a second."""
        return self.header.rate_hz

    @property
    def duration_s(self) -> float:
        """Duration in seconds: frames / rate."""
        return self.n_frames / self.rate_hz

    @property
    def shape(self) -> tuple[int, int, int]:
        """The shape of ``positions``: frames, markers, 3."""
        return self.n_frames, self.n_markers, 3

    def __len__(self) -> int:
        return self.n_frames

    def __repr__(self) -> str:
        within = f"within {self.header.tolerance_mm:g} mm" if self.header.tolerance_mm else "every bit"
        state = ("" if self.finished else ", cut off") + (", closed" if self.closed else "")
        return (
            f"<mocapd.Take {self.path!r}: {self.n_frames} frames at {self.rate_hz:g} Hz, "
            f"{self.n_markers} markers, {within}{state}>"
        )

    @cached_property
    def ledger(self) -> Ledger | None:
        """The account of every frame and sample; None if the take was cut off before the first ledger."""
        fields = self._file.ledger()
        return Ledger(**fields) if fields else None

    @cached_property
    def ending(self) -> Ending | None:
        """How the recording ended; None for imports, takes that were cut off, and takes of earlier versions."""
        ending = self._file.ending()
        return Ending(*ending) if ending else None

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """Marks, triggers, sync pulses, and reports of device and host, in order of time."""
        events = self._file.events()
        return tuple(Event(time_s=event["frame"] / self.rate_hz, **event) for event in events)

    @cached_property
    def clock_lines(self) -> tuple[ClockLine, ...]:
        """Maps from the device's clock to the host's, one for each run of the device's clock; empty for an import."""
        return tuple(ClockLine(**line) for line in self._file.clock_lines())

    # -- open and closed -----------------------------------------------------------------------------------

    def __enter__(self) -> Take:
        self._file.check_open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file. The header, the labels and arrays that were read stay; reading more is a ValueError.

        A take that is not closed stays open until nothing refers to it.
        """
        self._file.close()

    @property
    def closed(self) -> bool:
        """Whether the file is closed."""
        return self._file.closed

    # -- content besides positions -------------------------------------------------------------------------

    @cached_property
    def subject(self) -> Subject | None:
        """The captured person or object: name, skeleton and face; None if the take does not state it."""
        return Subject._of(self._file.subject(), self.path)

    @cached_property
    def metadata(self) -> Metadata:
        """The groups of parameters of an imported C3D file: ``take.metadata["POINT"]["UNITS"]``. Empty for other takes.

        Names are in upper case. A text is a str, several are a list of str; a number is an int or a float, several are
        an array with the dimensions of the C3D file (``CORNERS`` of two plates has the shape 3, 4, 2). Values are those
        of the file, in its units.

        Raises
        ------
        TakeError
            If this part of the take is damaged.
        """
        return metadata(self._file.parameters())

    @cached_property
    def analog(self) -> Analog:
        """The analog channels of an imported C3D file, in physical units. Without any, it has the length 0.

        What the file leaves open, such as a missing scale, is a :class:`TakeWarning`.

        Raises
        ------
        TakeError
            If this part of the take is damaged.
        """
        fields = self._file.analog()
        self._warn(fields["warnings"])
        return Analog(self._file, fields)

    @cached_property
    def _groups(self) -> tuple[tuple[SampledGroup, ...], tuple[ForcePlate, ...]]:
        """The groups of a recording, and its force plates."""
        found, problems = self._file.sampled()
        self._warn(problems)
        groups, plates = [], []
        for index, fields in enumerate(found):
            own = fields.pop("plates")  # type: ignore[misc]
            group = SampledGroup(self._file, index, fields)
            groups.append(group)
            plates += [ForcePlate(group, place, self.path, **plate) for place, plate in enumerate(own)]
        return tuple(groups), tuple(sorted(plates, key=lambda plate: plate.number))

    @cached_property
    def sampled(self) -> tuple[Analog, ...]:
        """The channels with rates of their own, in groups that are sampled together: of a recording those of its device
        (:class:`SampledGroup`), of an imported C3D file its analog channels, which are one group. Empty if there are none.

        Raises
        ------
        TakeError
            If this part of the take is damaged.
        """
        groups = self._groups[0]
        return groups or ((self.analog,) if len(self.analog) else ())

    @cached_property
    def force_plates(self) -> tuple[ForcePlate, ...]:
        """The force plates of an imported C3D file, or of a recording, in order. Empty if there are none.

        A plate that cannot be used, for example one of an unknown type, is left out with a :class:`TakeWarning`.

        Raises
        ------
        TakeError
            If this part of the take is damaged.
        """
        if self._groups[1]:
            return self._groups[1]
        plates, problems = self._file.force_plates()
        self._warn(problems)
        return tuple(ForcePlate(self.analog, index, self.path, **plate) for index, plate in enumerate(plates))

    @cached_property
    def poses(self) -> Poses:
        """The poses of the rigid bodies of a recording, frame by frame. Without any, it has the length 0.

        Raises
        ------
        ValueError
            If the take is closed.
        """
        return Poses(self._file, self.n_frames, self.rate_hz)

    # -- positions -----------------------------------------------------------------------------------------

    @cached_property
    def positions(self) -> Positions:
        """All positions: float32 [frames, markers, 3], millimetres, NaN for missing samples.

        Decoded once and cached, 12 bytes per sample; :meth:`read` decodes a part.
        """
        return self.read()

    def read(
        self,
        start_s: float | None = None,
        stop_s: float | None = None,
        markers: Markers = None,
        *,
        start_frame: int | None = None,
        stop_frame: int | None = None,
    ) -> Positions:
        """Reads a part of the positions: float32 [frames, markers, 3], millimetres, NaN for missing samples.

        Decodes only the necessary part of the file: from the key stretch before the start, at most ten seconds
        earlier, and only the groups of 64 markers that contain the requested ones.

        Parameters
        ----------
        start_s, stop_s
            Seconds from the first frame: reads frames at or after ``start_s`` and before ``stop_s``.
        markers
            Labels or columns, in the order of the result; by default all. The result has an axis of markers even
            for a single one.
        start_frame, stop_frame
            The range as frame indices from 0, instead of seconds.

        Raises
        ------
        KeyError
            If a marker is not in the take.
        ValueError
            For a negative time or NaN, an end before the start, or more than 2^30 samples.
        """
        first, stop = self._range(start_s, stop_s, start_frame, stop_frame)
        columns = self._columns(markers)
        return self._read(first, stop, columns)

    def __getitem__(self, key: object) -> Marker | Positions:
        if isinstance(key, str):
            return self.marker(key)
        frames, markers = key if isinstance(key, tuple) and len(key) == 2 else (key, None)
        rows = self._slice(frames)
        one = isinstance(markers, (str, int, np.integer))
        found = self._read(min(rows.start, rows.stop), rows.stop, self._columns(markers))
        found = found[:: rows.step]
        return found[:, 0] if one else found

    def marker(self, key: MarkerKey) -> Marker:
        """One marker, by label or column.

        Raises
        ------
        KeyError
            If no marker, or more than one, has that label, or there is no such column.
        """
        return Marker(self, self._columns(key)[0])

    @property
    def markers(self) -> list[Marker]:
        """All markers, in order of columns."""
        return [Marker(self, column) for column in range(self.n_markers)]

    def __iter__(self) -> Iterator[Marker]:
        return iter(self.markers)

    def __contains__(self, label: object) -> bool:
        return label in self.labels

    # -- knots, times and losses ---------------------------------------------------------------------------

    @cached_property
    def summary(self) -> dict[str, MarkerSummary]:
        """The counts of each marker over the whole take, by label; decodes the take once. If markers share a label,
        the later ones have their column appended: ``LKNE#7``.
        """
        columns = list(range(self.n_markers))
        found, problems = self._file.scan(columns, False, self._threads)
        self._warn(problems)
        return {
            name: MarkerSummary(label, samples, gaps, knots, error_mm)
            for name, label, (samples, gaps, knots, error_mm, _) in zip(unique_names(self.labels), self.labels, found)
        }

    def knots(self, markers: Markers = None) -> list[npt.NDArray[np.int64]]:
        """For each marker, the frames of its kept samples, which ``mocapd info`` counts as knots."""
        found, problems = self._file.scan(self._columns(markers), True, self._threads)
        self._warn(problems)
        return [knots for *_, knots in found]

    def times(self, start_s: float | None = None, stop_s: float | None = None) -> Times:
        """The times of frames by the device's clock and the host's, if the take has them.

        Raises
        ------
        ValueError
            For a negative time or NaN, an end before the start, or more than 2^28 frames.
        """
        first, stop = self._range(start_s, stop_s)
        # Five arrays of eight bytes a frame.
        check_size(stop - first, _TIMES_AS_SAMPLES, "times")
        frame = np.arange(first, stop, dtype=np.int64)
        nominal_s = frame / self.rate_hz
        device = self.header.device
        if device is None:
            return Times(frame, nominal_s, None, None, None, None)
        ticks, arrival_ns, recorded = self._file.times(first, stop)
        device_s = np.where(recorded, ticks / float(max(device.tick_hz, 1)), np.nan)
        host_s = np.where(recorded, arrival_ns / 1e9, np.nan)
        return Times(frame, nominal_s, device_s, host_s, ticks, recorded)

    @cached_property
    def lost(self) -> tuple[LostFrames, ...]:
        """Runs of lost frames with their causes. In all other frames a marker with NaN was not seen."""
        return tuple(LostFrames(*lost) for lost in self._file.lost())

    # -- conversion to other libraries ---------------------------------------------------------------------

    def to_xarray(
        self, start_s: float | None = None, stop_s: float | None = None, markers: Markers = None
    ) -> xarray.DataArray:
        """Positions as an ``xarray.DataArray`` with the dimensions time (seconds), marker and axis.

        Raises
        ------
        ImportError
            If xarray is not installed; ``pip install './python[xarray]'`` installs it.
        """
        return _tables.to_xarray(self, start_s, stop_s, markers)

    @overload
    def to_pandas(
        self,
        start_s: float | None = None,
        stop_s: float | None = None,
        markers: Markers = None,
        *,
        layout: Literal["wide", "long"] = "wide",
    ) -> pandas.DataFrame: ...

    @overload
    def to_pandas(
        self,
        content: Literal["positions"],
        /,
        start_s: float | None = None,
        stop_s: float | None = None,
        markers: Markers = None,
        *,
        layout: Literal["wide", "long"] = "wide",
    ) -> pandas.DataFrame: ...

    @overload
    def to_pandas(
        self,
        content: Literal["analog"],
        /,
        start_s: float | None = None,
        stop_s: float | None = None,
        channels: Sequence[str | int] | str | int | None = None,
    ) -> pandas.DataFrame: ...

    @overload
    def to_pandas(
        self,
        content: Literal["sampled"],
        /,
        group: int | None = None,
        start_s: float | None = None,
        stop_s: float | None = None,
        channels: Sequence[str | int] | str | int | None = None,
    ) -> pandas.DataFrame: ...

    @overload
    def to_pandas(
        self, content: Literal["force_plates"], /, start_s: float | None = None, stop_s: float | None = None
    ) -> pandas.DataFrame: ...

    @overload
    def to_pandas(
        self,
        content: Literal["poses"],
        /,
        start_s: float | None = None,
        stop_s: float | None = None,
        bodies: Bodies = None,
    ) -> pandas.DataFrame: ...

    @overload
    def to_pandas(self, content: Literal["events", "subject"], /) -> pandas.DataFrame: ...

    def to_pandas(self, *part: Any, **options: Any) -> pandas.DataFrame:
        """Positions, or another part of the take, as a ``pandas.DataFrame``.

        ``to_pandas(start_s, stop_s, markers, layout="wide")`` and ``to_pandas("positions", ...)``
            One row per frame, indexed by ``time_s``, seconds from the first frame; columns (marker, axis), in
            millimetres, NaN for missing samples. With ``layout="long"`` one row per sample that is there, with the
            columns ``frame``, ``marker``, ``x``, ``y``, ``z``.
        ``to_pandas("analog", start_s, stop_s, channels)``
            One row per analog sample, indexed by ``time_s``; a column for each channel, in its unit.
        ``to_pandas("sampled", group, start_s, stop_s, channels)``
            The same for a group of ``take.sampled``, by its index; it can be omitted if there is only one.
        ``to_pandas("force_plates", start_s, stop_s)``
            One row per sample of the plates, indexed by ``time_s``; columns (plate, quantity, axis), where quantity is
            ``force_n``, ``moment_nm``, ``cop_mm`` or ``free_moment_nm`` as in :class:`PlateLoads`.
        ``to_pandas("poses", start_s, stop_s, bodies)``
            One row per frame, indexed by ``time_s``; columns (body, quantity), where quantity is ``x``, ``y``, ``z``,
            ``qw``, ``qx``, ``qy``, ``qz``, ``residual`` or ``state`` as in :class:`PoseArrays`.
        ``to_pandas("events")``
            One row per event: ``time_s``, ``frame``, ``kind``, ``text``, ``input``, ``device_ticks``, ``host_ns``.
        ``to_pandas("subject")``
            One row per bone of the subject's skeleton, indexed by its name: ``parent``, ``child``, ``length_mm``,
            ``uncertainty_mm``, ``spread_mm``, ``scans``.

        ``frame.attrs`` states units and axes. If the take lacks the requested content, the frame is empty.

        Raises
        ------
        ImportError
            If pandas is not installed; ``pip install './python[pandas]'`` installs it.
        KeyError
            If a marker or channel is not in the take.
        TakeError
            If that part of the take is damaged.
        ValueError
            For another content or layout, a negative time or NaN, an end before the start, or too many samples.
        """
        content = "positions"
        if part and isinstance(part[0], str):
            content, *part = part
        return _tables.to_pandas(self, content, *part, **options)

    # -- helpers -------------------------------------------------------------------------------------------

    def _part(
        self, start_s: float | None, stop_s: float | None, markers: Markers
    ) -> tuple[Positions, list[int], npt.NDArray[np.float64]]:
        first, stop = self._range(start_s, stop_s)
        columns = self._columns(markers)
        return self._read(first, stop, columns), columns, np.arange(first, stop) / self.rate_hz

    def _read(self, first: int, stop: int, columns: list[int]) -> Positions:
        check_size(stop - first, len(columns), f"frames of {len(columns)} markers")
        if "positions" in self.__dict__ and not self.closed:
            return self.positions[first:stop, columns]
        out = np.empty((stop - first, len(columns), 3), dtype=np.float32)
        self._warn(self._file.read_into(out, first, columns, self._threads))
        return out

    def _warn(self, problems: list[str]) -> None:
        for problem in problems:
            if problem in self.problems:
                continue
            self.problems.append(problem)
            warnings.warn(f"{self.path}: {problem}", TakeWarning, stacklevel=4)

    def _warn_cut_off(self, problem: str) -> None:
        self.problems.append(problem)
        here = f"{self.n_frames} frames ({self.n_frames / self.rate_hz:.3f} s) can be read"
        hint = "`mocapd recover` writes them to a complete take"
        warnings.warn(f"{self.path}: {problem}; {here}. {hint}", TakeWarning, stacklevel=4)

    def _range(
        self, start_s: float | None, stop_s: float | None, start_frame: int | None = None, stop_frame: int | None = None
    ) -> tuple[int, int]:
        """The range of frames: the first, and one past the last."""
        first = self._frame(start_s, start_frame, 0)
        stop = self._frame(stop_s, stop_frame, self.n_frames)
        # Ends beyond the take are cut off to its length, so they are compared as given, too.
        for start, end in ((start_s, stop_s), (start_frame, stop_frame), (first, stop)):
            check_order(start, end)
        return first, stop

    def _frame(self, time_s: float | None, frame: int | None, default: int) -> int:
        if time_s is not None and frame is not None:
            raise ValueError("give the start or the stop either as a time or as a frame, not both")
        if frame is not None:
            if frame < 0:
                raise ValueError(f"frame {frame}: frames count from 0")
            return min(int(frame), self.n_frames)
        if time_s is None:
            return default
        return index_at(time_s, self.rate_hz, self.n_frames)

    def _slice(self, key: object) -> slice:
        if isinstance(key, slice):
            start, stop, step = key.indices(self.n_frames)
            if step < 0:
                raise ValueError("a slice of frames cannot have a negative step: reverse the array instead")
            return slice(start, max(start, stop), step)
        if isinstance(key, (int, np.integer)):
            raise TypeError(f"take[{key}]: for one frame use take[{key}:{key + 1}], for a marker take.marker({key})")
        raise TypeError(f"take[{key!r}]: use a label, a slice of frames, or both")

    def _columns(self, markers: Markers) -> list[int]:
        if markers is None:
            return list(range(self.n_markers))
        if isinstance(markers, (str, int, np.integer)):
            markers = [markers]
        return [self._column(marker) for marker in markers]

    def _column(self, marker: MarkerKey) -> int:
        if isinstance(marker, (int, np.integer)):
            if not 0 <= marker < self.n_markers:
                raise KeyError(f"no marker in column {marker}: the take has {self.n_markers} markers, counted from 0")
            return int(marker)
        found = [column for column, label in enumerate(self.labels) if label == marker]
        if len(found) == 1:
            return found[0]
        if found:
            raise KeyError(f"{len(found)} markers have the label {marker!r}: use one of their columns, {found}")
        raise KeyError(f"no marker has the label {marker!r}; the labels are {', '.join(self.labels[:20])}...")
