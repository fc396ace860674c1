"""The files that are ingested: found in folders and stores, and read by the workers."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ._keys import FORMATS, format_of
from ._store import Entry, FolderStore, Store, StoreError, open_store

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
        """The name in the catalogue: a URL. Bytes that are no text in UTF-8 are written as ``\\xfc``."""
        url = f"{self.store.url.rstrip('/')}/{self.name}"
        return url.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")

    @property
    def format(self) -> str:
        return format_of(self.name) or ""

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
        return groups.get("subject") or None, groups.get("session") or None


Sources = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]


def find(sources: Sources, bucket: Store) -> Iterator[SourceFile]:
    """The files in folders, with all folders in them, and single files: in order of names, each once. The takes of the
    archive itself are none.
    """
    listed = [sources] if isinstance(sources, (str, os.PathLike)) else list(sources)
    found: set[str] = set()
    own = f"{bucket.url.rstrip('/')}/takes/"
    for one in listed:
        for file in _find_in(os.fspath(one)):
            if file.source not in found and not file.source.startswith(own):
                found.add(file.source)
                yield file


def _find_in(text: str) -> Iterator[SourceFile]:
    folder, _, name = text.rstrip("/").rpartition("/")
    if "://" not in text:
        if not os.path.exists(text):
            raise FileNotFoundError(2, "no such file or folder to ingest", text)
        file = None if os.path.isdir(text) else _one(open_store(folder or ("/" if text.startswith("/") else ".")), name)
        if file is not None and file.format == "":
            raise ValueError(f"{text}: expected a file whose name ends in {', '.join(FORMATS)}")
    else:
        # A name of a file may also be that of a folder.
        is_folder = text.endswith("/") or format_of(name) is None
        file = None if is_folder else _one(open_store(folder), name)
    if file is not None:
        yield file
        return
    store, is_empty = open_store(text), True
    if isinstance(store, FolderStore):
        store = _SourceFolder(store.url.removeprefix("file://"))
    for entry in store.list():
        is_empty = False
        if format_of(entry.name) is not None or (isinstance(store, _SourceFolder) and entry.name in store.locked):
            yield SourceFile(store, entry.name, entry.n_bytes)
    if is_empty and "://" in text:
        raise FileNotFoundError(2, "no such file or folder to ingest, or an empty one", text)


class _SourceFolder(FolderStore):
    """A folder of sources. A folder in it that may not be listed, such as lost+found, is listed itself: as a file, which
    fails when it is read.
    """

    def __init__(self, path: str) -> None:
        super().__init__(path)
        self.locked: set[str] = set()

    def _walk(self, folder: str, begin: str = "") -> Iterator[Entry]:
        try:
            yield from super()._walk(folder, begin)
        except PermissionError:
            if not folder:
                raise
            self.locked.add(folder)
            yield Entry(folder, 0, None)

    def get(self, name: str) -> bytes:
        if name in self.locked:
            raise PermissionError(errno.EACCES, "the folder may not be listed", name)
        return super().get(name)


def _one(store: Store, name: str) -> SourceFile | None:
    n_bytes = store.size(name)
    return None if n_bytes is None else SourceFile(store, name, n_bytes)


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


OF_STORE = {errno.EIO, errno.ESTALE, errno.ENOTCONN, errno.ETIMEDOUT, errno.ENODEV, errno.EHOSTDOWN}
"""Errors of reading that every file of a disk or share has that is gone."""


OF_MACHINE = {errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE, errno.EAGAIN, errno.ENOMEM}
"""Errors that say that this machine lacks space, files, threads or memory: any file may get them."""


def is_of_machine(error: Exception) -> bool:
    return isinstance(error, MemoryError) or getattr(error, "errno", None) in OF_MACHINE


def is_of_file(error: Exception, store: Store) -> bool:
    """Whether an error of reading a file is its own, and neither of its store nor of this machine."""
    # Credentials that expire are refused for every object.
    is_refused = isinstance(error, PermissionError) and not isinstance(store, FolderStore)
    is_of_store = isinstance(error, StoreError) or is_refused or getattr(error, "errno", None) in OF_STORE
    return not is_of_store and not is_of_machine(error)
