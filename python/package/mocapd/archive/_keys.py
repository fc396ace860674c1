"""The settings of an import, and the keys of objects.

A key is the SHA-256 of a JSON document that holds everything on which the bytes of a take depend: the SHA-256 of the
source's bytes, its format, every setting, and the version of the importer. The source's name is not in it, and not in
the take. The same source and settings therefore have the same key on every machine, and an import that is repeated,
for any reason, writes the object that exists.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, cast

from .._native import importer_version

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
    return length


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
        is_lossless = self.resampler.partition(":")[0] == "lossless"
        if is_lossless:
            object.__setattr__(self, "tolerance_mm", None)
        elif self.tolerance_mm is None:
            raise ValueError(f"{self.resampler} needs a tolerance: state one, or use lossless:predictive")
        if self.resampler == "dense":
            object.__setattr__(self, "effort", 3 if self.effort is None else self.effort)
            if not 1 <= int(self.effort or 0) <= 9:
                raise ValueError(f"effort {self.effort}: expected 1 to 9")
        elif self.effort is not None:
            raise ValueError(f"the effort is for the resampler dense: omit it with {self.resampler}")
        else:
            object.__setattr__(self, "effort", 1)

    def options(self, format: str, subject: str | None) -> ImportOptions:
        """The options of the importer for a file."""
        options: Any = asdict(self) | {"format": format, "subject": subject}
        options["analog_tolerance"] = list(self.analog_tolerance)
        return cast("ImportOptions", options)

    def text(self, format: str, subject: str | None) -> str:
        """The settings that apply to a source, as JSON with sorted keys. None do to a take, which stays as it is."""
        if format == "take":
            return _json({"format": format})
        options = dict(self.options(format, subject))
        if options["keys_s"] == math.inf:
            options["keys_s"] = "none"
        return _json(options)


def _json(document: dict[str, Any]) -> str:
    return json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)


def source_hash(data: bytes) -> str:
    """The SHA-256 of a source's bytes, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def content_key(source_sha256: str, settings_text: str, importer: int = IMPORTER_VERSION) -> str:
    """The key of a source with settings: :meth:`Settings.text`."""
    document = {"importer": importer, "settings": json.loads(settings_text), "source": source_sha256}
    return hashlib.sha256(_json(document).encode()).hexdigest()


def object_name(key: str, repacked: str = "") -> str:
    """The name of a take in the bucket; that of a repacked one ends in a part of the hash of its bytes."""
    return f"takes/{key[:2]}/{key}{'-' if repacked else ''}{repacked[:16]}.take"


def object_key(name: str) -> str | None:
    """The key in the name of an object; None for another file."""
    found = re.fullmatch(r"takes/([0-9a-f]{2})/(\1[0-9a-f]{62})(-[0-9a-f]{16})?\.take", name)
    return found[2] if found else None
