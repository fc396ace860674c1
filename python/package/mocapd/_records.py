"""What a take says beside the motion, as plain records."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Device:
    """The device that was recorded, as it says itself."""

    driver: str
    uri: str
    model: str
    serial: str
    firmware: str
    tick_hz: int
    """Ticks of its clock a second."""
    low_latency: bool


@dataclass(frozen=True)
class Source:
    """What an imported take was made of."""

    format: str
    """``c3d``, ``trc``, ``tsv``, ``csv``; ``array`` for what :func:`write_take` wrote."""
    file: str
    unit: str
    factor_to_mm: float
    first_frame: int
    warnings: list[str]


@dataclass(frozen=True)
class Header:
    """What a take begins with."""

    software: str
    take_id: uuid.UUID
    created: datetime | None
    """When the recording began, in UTC; None for an import, which has no time of its own."""
    resampler: str
    tolerance_mm: float
    """Largest distance in 3D between a sample and its reconstruction; 0 for ``lossless``."""
    rate_hz: float
    up_axis: str | None
    """``x``, ``y`` or ``z``, where it is known."""
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
    """Every frame and sample accounted for; docs/take-format.md gives each counter's meaning."""

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
    """Whether what was sent is what was recorded and lost, and no counter contradicted itself."""


@dataclass(frozen=True)
class Ending:
    """How a take ended."""

    kind: str
    """``stopped``, ``length``, ``device ended``, ``device gone``, ``disk full`` and others; docs/api.md has the list."""
    detail: str
    """More about it; mostly empty."""


@dataclass(frozen=True)
class Event:
    """Something that happened beside the motion."""

    kind: str
    """``mark``, ``trigger``, ``sync pulse``, ``device`` or ``host``."""
    frame: int
    time_s: float
    """The frame's time in the take, from 0."""
    device_ticks: int
    """0 where the device did not say."""
    host_ns: int
    """The host's monotonic clock."""
    input: int
    text: str


@dataclass(frozen=True)
class ClockLine:
    """How the device's clock ran against the host's, for one run of the device's clock.

    ``host_ns + (ticks - device_ticks) * 1e9 / tick_hz * (1 + drift_ppm * 1e-6)`` is the host's time of ``ticks``.
    """

    segment: int
    device_ticks: int
    host_ns: int
    drift_ppm: float
    bound_us: int | None
    """How far it can be off where it is told; None where no round trip was measured."""


@dataclass(frozen=True)
class LostFrames:
    """Consecutive frames that are not in the take."""

    first_frame: int
    n_frames: int
    cause: str
    """``not received``, ``ring full``, ``disconnected``, ``damaged``, or several of them with commas."""


@dataclass(frozen=True)
class Times:
    """When frames were: arrays of one value a frame."""

    frame: npt.NDArray[np.int64]
    nominal_s: npt.NDArray[np.float64]
    """Frame / rate: seconds from the first frame."""
    device_s: npt.NDArray[np.float64] | None
    """The device's clock at exposure, in seconds; NaN where a frame was lost. None for an import."""
    host_s: npt.NDArray[np.float64] | None
    """The host's monotonic clock at arrival, in seconds, to within 0.32 ms; NaN where a frame was lost."""
    device_ticks: npt.NDArray[np.uint64] | None
    """The device's clock exactly; 0 where a frame was lost."""
    recorded: npt.NDArray[np.bool_] | None
    """Whether the frame was recorded. A frame that was, and where a marker is NaN, did not show the marker."""
