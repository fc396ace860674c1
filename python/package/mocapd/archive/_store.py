"""Where the bytes of an archive are: a folder, or a bucket of an object store."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable
from urllib.parse import unquote, urlsplit

import mocapd


class StoreError(Exception):
    """The store failed, so that it is not known whether an operation took effect. It can be repeated."""


@dataclass(frozen=True)
class Entry:
    """An object in a store."""

    name: str
    n_bytes: int
    modified_s: float
    """Seconds since 1970."""


@runtime_checkable
class Store(Protocol):
    """The operations that an archive needs. Objects are created whole, once, and never changed."""

    url: str

    def put_if_absent(self, name: str, data: bytes) -> bool:
        """Creates an object. False if it exists, which stays as it is."""

    def get(self, name: str) -> bytes: ...

    def get_range(self, name: str, start: int, stop: int) -> bytes: ...

    def size(self, name: str) -> int | None:
        """The size in bytes; None if there is no such object."""

    def list(self, prefix: str = "") -> Iterator[Entry]:
        """The objects whose names begin with ``prefix``, in order of names."""

    def remove(self, name: str) -> None: ...

    def open_take(self, name: str, threads: int = 1) -> mocapd.Take:
        """Opens a take, to read parts of it."""


class FolderStore:
    """A folder, which may be on a network file system with hard links."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._root = Path(path).absolute()
        self.url = self._root.as_uri()

    def _path(self, name: str) -> Path:
        parts = name.split("/")
        if not name or any(part in ("", ".", "..") for part in parts):
            raise ValueError(f"{name!r} is not the name of an object")
        return self._root.joinpath(*parts)

    def put_if_absent(self, name: str, data: bytes) -> bool:
        path = self._path(name)
        try:
            if path.exists():
                return False
            path.parent.mkdir(parents=True, exist_ok=True)
            return _create(path, data)
        except OSError as error:
            raise StoreError(f"cannot write {path}: {error.strerror or error}") from error

    def get(self, name: str) -> bytes:
        return self._path(name).read_bytes()

    def get_range(self, name: str, start: int, stop: int) -> bytes:
        with open(self._path(name), "rb") as file:
            return os.pread(file.fileno(), stop - start, start)

    def size(self, name: str) -> int | None:
        try:
            return self._path(name).stat().st_size
        except FileNotFoundError:
            return None

    def list(self, prefix: str = "") -> Iterator[Entry]:
        folder, _, begin = prefix.rpartition("/")
        yield from self._walk(folder, begin)

    def _walk(self, folder: str, begin: str = "") -> Iterator[Entry]:
        try:
            found = sorted(os.scandir(self._root / folder), key=lambda entry: entry.name)
        except FileNotFoundError:
            return
        for entry in found:
            # Hidden files are not objects: what a killed writer leaves where the system has no files without names.
            if entry.name.startswith(".") or not entry.name.startswith(begin):
                continue
            name = f"{folder}/{entry.name}" if folder else entry.name
            if entry.is_dir():
                yield from self._walk(name)
            else:
                status = entry.stat()
                if stat.S_ISREG(status.st_mode):
                    yield Entry(name, status.st_size, status.st_mtime)

    def remove(self, name: str) -> None:
        self._path(name).unlink(missing_ok=True)

    def open_take(self, name: str, threads: int = 1) -> mocapd.Take:
        return mocapd.open(self._path(name), threads=threads)


def _create(path: Path, data: bytes) -> bool:
    """Creates a file that is complete when its name appears, unless the name exists."""
    try:
        # A file without a name: if this process is killed, nothing is left of it.
        file = os.open(path.parent, os.O_TMPFILE | os.O_WRONLY, 0o644)
        temporary = None
    except (AttributeError, OSError):
        file, temporary = tempfile.mkstemp(prefix=".", dir=path.parent)
    try:
        with os.fdopen(file, "wb", closefd=False) as out:
            out.write(data)
        os.fsync(file)
        if temporary is None:
            # With a folder, even one that is not used, Python calls linkat, which follows the link in /proc.
            os.link(f"/proc/self/fd/{file}", path, src_dir_fd=file)
        else:
            os.link(temporary, path)
        return True
    except FileExistsError:
        return False
    finally:
        os.close(file)
        if temporary is not None:
            os.unlink(temporary)


def open_store(bucket: str | os.PathLike[str] | Store) -> Store:
    """The store of a folder, a URL, or a store."""
    if isinstance(bucket, Store):
        return bucket
    text = os.fspath(bucket)
    scheme = urlsplit(text).scheme if "://" in text else ""
    if scheme in ("", "file"):
        return FolderStore(unquote(urlsplit(text).path) if scheme else text)
    raise ValueError(f"{text}: expected a folder or a URL that begins with file://, found {scheme}://")
