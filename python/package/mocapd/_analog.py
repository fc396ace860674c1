"""Analog channels of an imported C3D file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Union

import numpy as np
import numpy.typing as npt

from ._ranges import check_size, index_range

if TYPE_CHECKING:
    from ._native import AnalogFields, TakeFile

Values = npt.NDArray[np.float64]
ChannelKey = Union[str, int]
Channels = Union[Sequence[ChannelKey], ChannelKey, None]


class Analog:
    """The analog channels of an imported C3D file, in physical units.

    ``take.analog["Fz1"]`` is a channel, ``len(take.analog)`` the number of channels; :meth:`read` reads some or all.
    A value is (sample - OFFSET) * SCALE * GEN_SCALE of the C3D file's ANALOG group.
    """

    def __init__(self, file: TakeFile, found: AnalogFields) -> None:
        self._file = file
        self.rate_hz: float = found["rate_hz"]
        """Samples a second of each channel; 0 without channels."""
        self.samples_per_frame: int = found["samples_per_frame"]
        """Samples of each channel in a frame of the take; 0 without channels."""
        self.n_samples: int = found["n_samples"]
        """Samples of each channel: those of all frames. NaN stands for samples that the file does not have."""
        self.channels: tuple[AnalogChannel, ...] = tuple(
            AnalogChannel(self, index, **channel) for index, channel in enumerate(found["channels"])
        )
        """The channels, in the order of the file."""

    def __repr__(self) -> str:
        return f"<mocapd.Analog: {len(self)} channels of {self.n_samples} samples at {self.rate_hz:g} Hz>"

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the channels."""
        return tuple(channel.name for channel in self.channels)

    @property
    def duration_s(self) -> float:
        """Duration of the samples, in seconds."""
        return self.n_samples / self.rate_hz if self.rate_hz else 0.0

    @property
    def time_s(self) -> Values:
        """The times of all samples, in seconds from the first frame: sample / rate. The first sample of a frame has
        the frame's time.
        """
        return self._times(0, self.n_samples)

    @cached_property
    def values(self) -> Values:
        """All samples: float64 [samples, channels], each channel in its unit. Decoded once and cached, 8 bytes per
        sample; :meth:`read` decodes a part.
        """
        return self.read()

    def read(self, start_s: float | None = None, stop_s: float | None = None, channels: Channels = None) -> Values:
        """Reads a part: float64 [samples, channels], each channel in its unit.

        Parameters
        ----------
        start_s, stop_s
            Seconds from the first frame: reads samples at or after ``start_s`` and before ``stop_s``.
        channels
            Names or indices, in the order of the result; by default all. The result has an axis of channels even for
            a single one.

        Raises
        ------
        KeyError
            If a channel is not in the take.
        TakeError
            If the samples are damaged.
        ValueError
            For a negative time or NaN, an end before the start, more than 2^30 samples, or a take that is closed.
        """
        first, stop = self._range(start_s, stop_s)
        return self._read(first, stop, self._indices(channels))

    def times(self, start_s: float | None = None, stop_s: float | None = None) -> Values:
        """The times of the samples that :meth:`read` reads, in seconds from the first frame."""
        return self._times(*self._range(start_s, stop_s))

    def __getitem__(self, key: ChannelKey) -> AnalogChannel:
        """A channel by name or index; KeyError if there is none, or if several have the name."""
        return self.channels[self._index(key)]

    def __iter__(self) -> Iterator[AnalogChannel]:
        return iter(self.channels)

    def __len__(self) -> int:
        return len(self.channels)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def _range(self, start_s: float | None, stop_s: float | None) -> tuple[int, int]:
        return index_range(start_s, stop_s, self.rate_hz, self.n_samples)

    def _times(self, first: int, stop: int) -> Values:
        return np.arange(first, stop) / (self.rate_hz or 1.0)

    def _read(self, first: int, stop: int, indices: list[int]) -> Values:
        check_size(stop - first, len(indices), f"samples of {len(indices)} channels")
        if "values" in self.__dict__ and not self._file.closed:
            return self.values[first:stop, indices]
        out = np.empty((stop - first, len(indices)))
        self._file.read_analog(out, first, indices)
        return out

    def _read_loads(self, out: Values, first: int, plates: list[int]) -> None:
        self._file.read_loads(out, first, plates)

    def _indices(self, channels: Channels) -> list[int]:
        if channels is None:
            return list(range(len(self)))
        if isinstance(channels, (str, int, np.integer)):
            channels = [channels]
        return [self._index(channel) for channel in channels]

    def _index(self, key: ChannelKey) -> int:
        if isinstance(key, (int, np.integer)):
            if not 0 <= key < len(self):
                raise KeyError(f"no channel {key}: the take has {len(self)} analog channels, counted from 0")
            return int(key)
        found = [index for index, name in enumerate(self.names) if name == key]
        if len(found) == 1:
            return found[0]
        if found:
            raise KeyError(f"{len(found)} channels have the name {key!r}: use one of their indices, {found}")
        names = ", ".join(self.names[:20]) + ("..." if len(self) > 20 else "")
        raise KeyError(f"no analog channel has the name {key!r}; the names are {names or 'none'}")


class AnalogChannel:
    """An analog channel."""

    def __init__(
        self, analog: Analog, index: int, *, name: str, unit: str, description: str, scale: float, offset: float
    ) -> None:
        self.analog = analog
        self.index = index
        """Its index among the channels, from 0; the C3D file counts from 1."""
        self.name = name
        """Its label; ``A1``... for a channel without one."""
        self.unit = unit
        """The unit as the file states it, such as ``V``, ``N`` or ``Nmm``; empty if it states none."""
        self.description = description
        """Free text; may be empty."""
        self.scale = scale
        """Physical units for one step of the stored samples: SCALE * GEN_SCALE."""
        self.offset = offset
        """The stored sample of the value 0."""

    def __repr__(self) -> str:
        unit = f" in {self.unit}" if self.unit else ""
        return f"<mocapd.AnalogChannel {self.name!r}{unit}>"

    @property
    def rate_hz(self) -> float:
        """Samples a second."""
        return self.analog.rate_hz

    @property
    def time_s(self) -> Values:
        """The times of all samples, in seconds from the first frame."""
        return self.analog.time_s

    @cached_property
    def values(self) -> Values:
        """All samples: float64 [samples], in ``unit``."""
        return self.read()

    def read(self, start_s: float | None = None, stop_s: float | None = None) -> Values:
        """The samples from ``start_s`` to before ``stop_s``: float64 [samples], in ``unit``."""
        return self.analog.read(start_s, stop_s, self.index)[:, 0]
