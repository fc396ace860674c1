"""The columns of the catalogue, and the rows of sources."""

from __future__ import annotations

from datetime import datetime, timezone
from typing import Any

import pyarrow as pa

import mocapd

from .._native import Imported, TakeFile
from ._keys import IMPORTER_VERSION

_POINT = pa.list_(pa.float32())

LEDGER = pa.struct(
    [
        (name, pa.int64())
        for name in (
            "frames_sent",
            "recorded",
            "lost_on_link",
            "dropped_by_device",
            "lost_ring_full",
            "lost_other",
            "samples_announced",
            "samples_present",
            "samples_occluded",
        )
    ]
    + [("closes", pa.bool_())]
)

SCHEMA = pa.schema(
    [
        # A take, a duplicate of the bytes and settings of one, or a source that failed.
        ("status", pa.string()),
        ("key", pa.string()),
        # Name of the object in the bucket.
        ("object", pa.string()),
        ("source", pa.string()),
        ("source_sha256", pa.string()),
        ("source_bytes", pa.int64()),
        ("format", pa.string()),
        ("subject", pa.string()),
        ("session", pa.string()),
        ("labels", pa.list_(pa.string())),
        ("markers", pa.int32()),
        ("rate_hz", pa.float64()),
        ("frames", pa.int64()),
        ("seconds", pa.float64()),
        # Unit of length of the source, as it states it; takes are in millimetres.
        ("unit", pa.string()),
        ("up_axis", pa.string()),
        # 0 for lossless takes.
        ("tolerance_mm", pa.float64()),
        ("resampler", pa.string()),
        ("max_error_mm", pa.float64()),
        ("samples", pa.int64()),
        # Runs of missing samples, over all markers.
        ("gaps", pa.int64()),
        ("ledger", LEDGER),
        ("low_mm", _POINT),
        ("high_mm", _POINT),
        ("peak_speed_mm_per_s", pa.float64()),
        # One for each label, in the same order.
        (
            "motion",
            pa.list_(
                pa.struct(
                    [
                        ("samples", pa.int64()),
                        ("gaps", pa.int64()),
                        ("low_mm", _POINT),
                        ("high_mm", _POINT),
                        ("peak_speed_mm_per_s", pa.float64()),
                    ]
                )
            ),
        ),
        (
            "events",
            pa.list_(
                pa.struct([("time_s", pa.float64()), ("frame", pa.int64()), ("kind", pa.string()), ("text", pa.string())])
            ),
        ),
        ("warnings", pa.list_(pa.string())),
        ("take_bytes", pa.int64()),
        ("take_sha256", pa.string()),
        # All settings of the import, as JSON.
        ("settings", pa.string()),
        ("importer", pa.int32()),
        ("software", pa.string()),
        ("error", pa.string()),
        ("ingested", pa.timestamp("us", tz="UTC")),
    ]
)


def _motion_fields(measured: Imported) -> dict[str, Any]:
    """What the markers of a take did."""
    seen = measured.samples > 0
    columns = (measured.samples, measured.gaps, measured.low_mm, measured.high_mm, measured.peak_speed_mm_per_s)
    by_marker = [
        {
            "samples": samples,
            "gaps": gaps,
            "low_mm": low if samples else None,
            "high_mm": high if samples else None,
            "peak_speed_mm_per_s": speed,
        }
        for samples, gaps, low, high, speed in zip(*(column.tolist() for column in columns))
    ]
    return {
        "samples": int(measured.samples.sum()),
        "gaps": int(measured.gaps.sum()),
        "low_mm": measured.low_mm[seen].min(axis=0).tolist() if seen.any() else None,
        "high_mm": measured.high_mm[seen].max(axis=0).tolist() if seen.any() else None,
        "peak_speed_mm_per_s": float(measured.peak_speed_mm_per_s.max(initial=0.0)),
        "motion": by_marker,
    }


def take_fields(take: TakeFile, measured: Imported) -> dict[str, Any]:
    """The columns that describe a take."""
    header, ledger, subject = take.header(), take.ledger(), take.subject()
    source = header["source"] or {}
    rate_hz, n_frames = header["rate_hz"], take.n_rows
    events = [
        {"time_s": event["frame"] / rate_hz, **{name: event[name] for name in ("frame", "kind", "text")}}
        for event in take.events()
    ]
    fields = {
        "subject": subject[0] if subject else None,
        "labels": list(take.labels),
        "markers": len(take.labels),
        "rate_hz": rate_hz,
        "frames": n_frames,
        "seconds": n_frames / rate_hz,
        "unit": source.get("unit"),
        "up_axis": header["up_axis"],
        "tolerance_mm": header["tolerance_mm"],
        "resampler": header["resampler"],
        "max_error_mm": measured.max_error_mm,
        "ledger": ledger and {field.name: ledger[field.name] for field in LEDGER},
        "events": events,
        "warnings": list(source.get("warnings") or ()) + take.problems,
    }
    return fields | _motion_fields(measured)


def new_row(status: str, source: str, **fields: Any) -> dict[str, Any]:
    """A row of the catalogue."""
    now = datetime.now(timezone.utc)
    base = {
        "status": status,
        "source": source,
        "importer": IMPORTER_VERSION,
        "software": f"mocapd {mocapd.__version__}",
        "ingested": now,
    }
    return base | fields
