"""Caches verified results between runs: one JSON file per take and codec, keyed by codec version and tolerance.

A result depends on nothing else, so a new version of mocapd is compared without running the peers again.
"""

import json
import os
from dataclasses import asdict
from pathlib import Path

from families.base import Result


class Cache:
    """The results of one take and codec; with `folder` None they are not written to disk."""

    def __init__(self, folder, take_sha256, codec_name):
        self.path = Path(folder) / f"{take_sha256[:16]}-{codec_name}.json".replace(" ", "-") if folder else None
        self.entries = json.loads(self.path.read_text()) if self.path and self.path.exists() else {}

    def result(self, codec, gaps, tolerance_mm, compute, plain=False):
        """The cached result, or that of `compute`, which is then cached; None (the codec refuses) is cached too."""
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
