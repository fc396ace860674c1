"""The files that are ingested: found in folders and stores, and read by the workers."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ._keys import FORMATS
from ._store import FolderStore, Store, StoreError, open_store

BATCH_FILES = 64
"""Most files of a task: at 60 files a second a task then takes a second, a hundred times what Ray needs to start it."""

BATCH_BYTES = 64 << 20
"""Bytes of a task after which it gets no more files, so that tasks with large files do not last for minutes."""


@dataclass(frozen=True)
class SourceFile:
    """A file to ingest."""

    store: Store
    name: str
    """Within the store."""
    n_bytes: int

    @property
    def source(self) -> str:
        """The name in the catalogue: a URL."""
        return f"{self.store.url.rstrip('/')}/{self.name}"

    @property
    def format(self) -> str:
        return self.name.rpartition(".")[2].lower()

    def read(self) -> bytes:
        return self.store.get(self.name)


@dataclass(frozen=True)
class Names:
    """What the names of sources say of their subject and session: named groups of a regular expression."""

    pattern: str | None = None

    def __post_init__(self) -> None:
        if self.pattern is not None and not {"subject", "session"} & set(re.compile(self.pattern).groupindex):
            raise ValueError(
                f"names {self.pattern!r}: expected a regular expression with a group (?P<subject>...) or (?P<session>...)"
            )

    def of(self, source: str) -> tuple[str | None, str | None]:
        """The subject and the session."""
        found = re.search(self.pattern, source) if self.pattern else None
        groups = found.groupdict() if found else {}
        return groups.get("subject"), groups.get("session")


Sources = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]


def find(sources: Sources) -> Iterator[SourceFile]:
    """The files in folders, with all folders in them, and single files: in order of names, each once."""
    listed = [sources] if isinstance(sources, (str, os.PathLike)) else list(sources)
    for one in listed:
        text = os.fspath(one)
        if "://" not in text and not os.path.exists(text):
            raise FileNotFoundError(2, "no such file or folder to ingest", text)
        folder, name = os.path.split(text.rstrip("/"))
        is_file = os.path.isfile(text) if "://" not in text else name.rpartition(".")[2].lower() in FORMATS
        if not is_file:
            store = open_store(text)
            for entry in store.list():
                if entry.name.rpartition(".")[2].lower() in FORMATS:
                    yield SourceFile(store, entry.name, entry.n_bytes)
            continue
        store = open_store(folder or ".")
        n_bytes = store.size(name)
        if n_bytes is None:
            raise FileNotFoundError(2, "no such file to ingest", text)
        if name.rpartition(".")[2].lower() not in FORMATS:
            raise ValueError(f"{text}: expected a file whose name ends in {', '.join(FORMATS)}")
        yield SourceFile(store, name, n_bytes)


def batches(files: Iterable[SourceFile], files_max: int) -> Iterator[list[SourceFile]]:
    """Groups files into tasks."""
    batch: list[SourceFile] = []
    n_bytes = 0
    for file in files:
        batch.append(file)
        n_bytes += file.n_bytes
        if len(batch) >= files_max or n_bytes >= BATCH_BYTES:
            yield batch
            batch, n_bytes = [], 0
    if batch:
        yield batch


def is_of_file(error: OSError, file: SourceFile) -> bool:
    """Whether an error of reading is of the file, and not of its store."""
    return isinstance(file.store, FolderStore) and not isinstance(error, StoreError)
