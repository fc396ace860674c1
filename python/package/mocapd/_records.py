"""Records of a take's header, events, clock and ledger."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Device:
    """The recorded device, as it describes itself."""

    driver: str
    uri: str
    model: str
    serial: str
    firmware: str
    tick_hz: int
    """Clock ticks a second."""
    low_latency: bool
    """Whether the serial line ran in the kernel's low-latency mode."""


@dataclass(frozen=True)
class Source:
    """The source of an imported take."""

    format: str
    """``c3d``, ``trc``, ``tsv`` or ``csv``; ``array`` for a take from :func:`write_take` or :func:`compress`."""
    file: str
    unit: str
    """Unit of length as the file states it; empty if it states none."""
    factor_to_mm: float
    first_frame: int
    """Number of the first frame in the file."""
    warnings: list[str]


@dataclass(frozen=True)
class Header:
    """The header of a take."""

    software: str
    take_id: uuid.UUID
    created: datetime | None
    """Start of the recording in UTC; None for an import."""
    resampler: str
    tolerance_mm: float
    """Largest allowed Euclidean distance in 3D between a sample and its reconstruction; 0 for ``lossless``."""
    rate_hz: float
    up_axis: str | None
    """``x``, ``y`` or ``z``; None if unknown."""
    device: Device | None
    """None for an import."""
    source: Source | None
    """None for a recording."""
    settings: tuple[tuple[str, str], ...]

    @classmethod
    def _of(cls, fields: dict[str, Any]) -> Header:
        created_unix_ms = fields.pop("created_unix_ms")
        created = datetime.fromtimestamp(created_unix_ms / 1000, timezone.utc) if created_unix_ms else None
        device, source = fields.pop("device"), fields.pop("source")
        return cls(
            take_id=uuid.UUID(bytes=fields.pop("take_id")),
            created=created,
            device=Device(**device) if device else None,
            source=Source(**source) if source else None,
            settings=tuple(fields.pop("settings")),
            **fields,
        )


@dataclass(frozen=True)
class Ledger:
    """The account of every frame and sample; docs/take-format.md explains each counter."""

    finished: bool
    frames_sent: int
    recorded: int
    lost_on_link: int
    dropped_by_device: int
    lost_ring_full: int
    lost_other: int
    duplicates: int
    unknown_after_disconnect: int
    samples_announced: int
    samples_present: int
    samples_occluded: int
    samples_not_finite: int
    markers_dropped: int
    link_bytes: int
    link_bytes_skipped: int
    link_messages: int
    link_messages_damaged: int
    link_messages_unknown: int
    contradictions: list[str]
    closes: bool
    """Whether frames and samples balance, and no counters contradict each other."""


@dataclass(frozen=True)
class Ending:
    """How a recording ended."""

    kind: str
    """``stopped``, ``length``, ``device ended``, ``device gone``, ``disk full`` and others, listed in docs/api.md."""
    detail: str
    """Additional information; usually empty."""


@dataclass(frozen=True)
class Event:
    """An event during the recording, or one of the imported file."""

    kind: str
    """``mark``, ``trigger``, ``sync pulse``, ``device`` or ``host``."""
    frame: int
    time_s: float
    """The frame's time in seconds from the first frame."""
    device_ticks: int
    """The device's clock; 0 if unknown."""
    host_ns: int
    """The host's monotonic clock, in nanoseconds."""
    input: int
    """Number of the device's input that a trigger or sync pulse came from."""
    text: str


@dataclass(frozen=True)
class ClockLine:
    """A linear map from the device's clock to the host's, for one run of the device's clock.

    The host's time of ``ticks`` is ``host_ns + (ticks - device_ticks) * 1e9 / tick_hz * (1 + drift_ppm * 1e-6)``.
    """

    segment: int
    device_ticks: int
    host_ns: int
    drift_ppm: float
    bound_us: int | None
    """Largest possible error at the reference point, in microseconds; None if no round trip was measured."""


@dataclass(frozen=True)
class LostFrames:
    """Consecutive lost frames."""

    first_frame: int
    n_frames: int
    cause: str
    """``not received``, ``ring full``, ``disconnected``, ``damaged``, or several of them separated by commas."""


@dataclass(frozen=True)
class Times:
    """The times of frames: arrays with one value for each frame."""

    frame: npt.NDArray[np.int64]
    nominal_s: npt.NDArray[np.float64]
    """Frame / rate, in seconds from the first frame."""
    device_s: npt.NDArray[np.float64] | None
    """The device's time stamp, in seconds; NaN for lost frames. None for an import."""
    host_s: npt.NDArray[np.float64] | None
    """The host's monotonic clock at arrival, in seconds, to within 0.32 ms; NaN for lost frames. None for an import."""
    device_ticks: npt.NDArray[np.uint64] | None
    """The device's time stamp, in ticks; 0 for lost frames. None for an import."""
    recorded: npt.NDArray[np.bool_] | None
    """Whether the frame was recorded. If it was, a marker with NaN was not seen. None for an import."""
