"""Keeps verified results between runs: one JSON file for each take and codec, keyed by versions and tolerance.

A result depends on nothing else, so a new mocapd is compared without running the peers again.
"""

import json
import os
from dataclasses import asdict
from pathlib import Path

from families.base import Result


class Cache:
    """`folder` None: nothing is kept."""

    def __init__(self, folder, take_sha256, codec_name):
        self.path = Path(folder) / f"{take_sha256[:16]}-{codec_name}.json".replace(" ", "-") if folder else None
        self.entries = json.loads(self.path.read_text()) if self.path and self.path.exists() else {}

    def result(self, codec, gaps, tolerance_mm, compute, plain=False):
        """The kept result, or the one of `compute`, kept from then on; None is a result too (codec refused)."""
        key = f"{codec.versions}, {tolerance_mm:g} mm, gaps {gaps}{', plain' * plain}"
        if key not in self.entries:
            result = compute()
            self.entries[key] = asdict(result) if result else None
            self.save()
        kept = self.entries[key]
        return Result(**kept) if kept else None

    def save(self):
        if not self.path:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        new = self.path.with_suffix(f".{os.getpid()}")
        new.write_text(json.dumps(self.entries, indent=1))
        new.replace(self.path)
