"""The settings of an import, and the keys of objects.

A key is the SHA-256 of a JSON document that holds everything on which the bytes of a take depend: the SHA-256 of the
source's bytes, its format, every setting, and the version of the importer; for a take, which is stored as it is, the first
two only. The source's name is not in it, and not in
the take. The same source and settings therefore have the same key on every machine, and an import that is repeated,
for any reason, writes the object that exists.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from .._native import importer_version, normal_options

if TYPE_CHECKING:
    from .._native import ImportOptions

IMPORTER_VERSION: int = importer_version()
"""Raised by every change of the importer after which a file may give other bytes with the same settings."""

FORMATS = ("c3d", "trc", "tsv", "csv", "take")
"""Formats of sources, which are also the extensions of their files. Takes are stored as they are."""

_LENGTHS_MM = {"": 1.0, "mm": 1.0, "um": 1e-3, "cm": 10.0, "m": 1000.0}


def tolerance_mm(text: str | float | None) -> float | None:
    """A tolerance in millimetres, from a number of millimetres or a text such as ``0.5mm`` or ``100um``."""
    if text is None:
        return None
    found = re.fullmatch(r"\s*([0-9.]+(?:e-?[0-9]+)?)\s*(mm|um|cm|m|)\s*", str(text), re.IGNORECASE)
    try:
        length = float(found[1]) * _LENGTHS_MM[found[2].lower()] if found else math.nan
    except ValueError:
        length = math.nan
    if not 0 < length < math.inf:
        raise ValueError(f"tolerance {text!r}: expected a length above 0, such as 0.5mm, 100um or 2cm")
    # 700um are 0.7 mm, and not 0.7000000000000001.
    return float(f"{length:.12g}")


_TIMES_S = {"s": 1.0, "ms": 1e-3, "min": 60.0, "": 1.0}


def key_seconds(text: str | float | None) -> float | None:
    """A distance of key stretches in seconds, from a number of seconds or a text such as ``2s``, ``500ms`` or ``none``."""
    if text is None:
        return None
    if str(text) in ("none", "inf"):
        return math.inf
    found = re.fullmatch(r"\s*([0-9.]+)\s*(s|ms|min|)\s*", str(text))
    try:
        return float(f"{float(found[1]) * _TIMES_S[found[2]]:.12g}") if found else math.nan
    except ValueError:
        return math.nan


def format_of(name: str) -> str | None:
    """The format of a source, by the end of its name; None for another file."""
    stem, dot, end = name.rpartition("/")[2].rpartition(".")
    return end.lower() if stem and dot and end.lower() in FORMATS else None


@dataclass(frozen=True)
class Settings:
    """How sources are imported; the defaults are those of ``mocapd import``."""

    tolerance_mm: float | None = 0.5
    """None for a lossless resampler."""
    resampler: str = "dense"
    effort: int | None = None
    """1 to 9 for ``dense``, 3 if None."""
    keys_s: float | None = None
    """Longest time from one key stretch to the next; infinite for the first stretch only."""
    unit: str | None = None
    up: str | None = None
    analog_tolerance: tuple[str, ...] = ()
    drop_foreign: bool = False

    def __post_init__(self) -> None:
        """Checks the settings, as the importer does, and writes them as it does, so that equal settings have equal keys."""

        def assign(**values: Any) -> None:
            for name, value in values.items():
                object.__setattr__(self, name, value)

        is_lossless = self.resampler.partition(":")[0] == "lossless"
        if not is_lossless and self.tolerance_mm is None:
            raise ValueError(f"{self.resampler} needs a tolerance: state one, or use lossless:predictive")
        is_dense = self.resampler == "dense"
        if not is_dense and self.effort not in (None, 1):
            raise ValueError(f"the effort is for the resampler dense: omit it with {self.resampler}")
        effort = self.effort if self.effort is not None else 3 if is_dense else 1
        if not 1 <= effort <= 9:
            raise ValueError(f"effort {effort}: expected 1 to 9")
        assign(
            tolerance_mm=None if is_lossless or self.tolerance_mm is None else float(self.tolerance_mm),
            effort=int(effort),
            keys_s=None if self.keys_s is None else float(self.keys_s),
            analog_tolerance=tuple(self.analog_tolerance),
        )
        resampler, unit, up, analog = normal_options(self.options("c3d", None))
        assign(resampler=resampler, unit=unit, up=up, analog_tolerance=tuple(analog))

    def options(self, format: str, subject: str | None) -> ImportOptions:
        """The options of the importer for a file."""
        options: Any = vars(self) | {"format": format, "subject": subject}
        options["analog_tolerance"] = list(self.analog_tolerance)
        return cast("ImportOptions", options)

    def document(self, format: str, subject: str | None) -> dict[str, Any]:
        """The settings that apply to a source. None do to a take, which stays as it is."""
        if format == "take":
            return {"format": format}
        options = dict(self.options(format, subject))
        if options["keys_s"] == math.inf:
            options["keys_s"] = "none"
        return options


def to_json(document: dict[str, Any]) -> str:
    """JSON with sorted keys, without spaces."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)


def source_hash(data: bytes) -> str:
    """The SHA-256 of a source's bytes, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def content_key(source_sha256: str, settings: dict[str, Any], importer: int = IMPORTER_VERSION) -> str:
    """The key of a source with settings: :meth:`Settings.document`."""
    document: dict[str, Any] = {"settings": settings, "source": source_sha256}
    if settings["format"] != "take":
        document["importer"] = importer
    return hashlib.sha256(to_json(document).encode()).hexdigest()


def object_name(key: str, repacked: str = "") -> str:
    """The name of a take in the bucket; that of a repacked one ends in a part of the hash of its bytes."""
    return f"takes/{key[:2]}/{key}{'-' if repacked else ''}{repacked[:16]}.take"


def object_key(name: str) -> str | None:
    """The key in the name of an object; None for another file."""
    found = re.fullmatch(r"takes/([0-9a-f]{2})/(\1[0-9a-f]{62})(-[0-9a-f]{16})?\.take", name)
    return found[2] if found else None
