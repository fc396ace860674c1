"""Where the bytes of an archive are: a folder, or a bucket of an object store."""

from __future__ import annotations

import errno
import os
import secrets
import stat
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

import mocapd

from .._native import ObjectStore, RemoteTake


class StoreError(Exception):
    """The store failed, so that it is not known whether an operation took effect. It can be repeated."""


@dataclass(frozen=True)
class Entry:
    """An object in a store."""

    name: str
    n_bytes: int
    modified_s: float | None
    """Seconds since 1970; None if the store does not state it."""


@runtime_checkable
class Store(Protocol):
    """The operations that an archive needs. Objects are created whole, once, and never changed."""

    url: str

    def put_if_absent(self, name: str, data: bytes) -> bool:
        """Creates an object. False if it exists with these bytes.

        Raises
        ------
        FileExistsError
            If it exists with others, and stays as it is.
        """

    def get(self, name: str) -> bytes: ...

    def size(self, name: str) -> int | None:
        """The size in bytes; None if there is no such object."""

    def list(self, prefix: str = "") -> Iterator[Entry]:
        """The objects whose names begin with ``prefix``, in order of names."""

    def remove(self, name: str) -> None: ...

    def open_take(self, name: str) -> WindowTake:
        """Opens a take, to read windows of it."""


class WindowTake(Protocol):
    """A take of which windows are read."""

    rate_hz: float
    n_frames: int
    labels: tuple[str, ...]

    def window(self, first: int, stop: int, columns: list[int]) -> npt.NDArray[np.float32]:
        """Positions of frames, as :meth:`mocapd.Take.read` gives them."""


class FolderStore:
    """A folder, which may be on a network file system with hard links."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._root = Path(path).resolve()
        # Literal, as mocapd's other commands write URLs of files: nothing is encoded.
        self.url = f"file://{self._root}"

    def _path(self, name: str) -> Path:
        parts = name.split("/")
        if not name or any(part in ("", ".", "..") for part in parts):
            raise ValueError(f"{name!r} is not the name of an object")
        return self._root.joinpath(*parts)

    def put_if_absent(self, name: str, data: bytes) -> bool:
        path = self._path(name)
        try:
            if not path.exists():
                _make_folder(path.parent)
                if _create(path, data):
                    return True
            if path.read_bytes() == data:
                return False
        except OSError as error:
            raise StoreError(f"cannot write {path}: {error.strerror or error}") from error
        raise FileExistsError(17, "exists already with other bytes", str(path))

    def get(self, name: str) -> bytes:
        return self._path(name).read_bytes()

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
            # Links to folders are not followed, as by other commands: they may lead back.
            if entry.is_dir(follow_symlinks=False):
                yield from self._walk(name)
                continue
            try:
                status = entry.stat()
            except OSError:
                # It was removed, or its link leads nowhere: who reads it gets the error.
                yield Entry(name, 0, None)
                continue
            if stat.S_ISREG(status.st_mode):
                yield Entry(name, status.st_size, status.st_mtime)

    def remove(self, name: str) -> None:
        self._path(name).unlink(missing_ok=True)

    def open_take(self, name: str) -> WindowTake:
        return _FileTake(mocapd.open(self._path(name), threads=1))


class _FileTake:
    """A take in a file."""

    def __init__(self, take: mocapd.Take) -> None:
        self._take = take
        self.rate_hz, self.n_frames, self.labels = take.rate_hz, take.n_frames, take.labels

    def window(self, first: int, stop: int, columns: list[int]) -> npt.NDArray[np.float32]:
        return self._take.read(start_frame=first, stop_frame=stop, markers=columns)


class BucketStore:
    """A bucket of an object store, or a folder in it: ``s3://``, ``gs://``, ``az://``. Its requests are counted."""

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")
        self._native = ObjectStore(self.url)

    def __reduce__(self) -> tuple[type[BucketStore], tuple[str]]:
        # Other processes have connections of their own.
        return BucketStore, (self.url,)

    def put_if_absent(self, name: str, data: bytes) -> bool:
        with _temporary_failures():
            return self._native.create(name, data)

    def get(self, name: str) -> bytes:
        with _temporary_failures():
            return self._native.read(name)

    def size(self, name: str) -> int | None:
        with _temporary_failures():
            return self._native.size(name)

    def list(self, prefix: str = "") -> Iterator[Entry]:
        with _temporary_failures():
            found = self._native.list(prefix.rpartition("/")[0])
        return (Entry(*entry) for entry in found if entry[0].startswith(prefix))

    def remove(self, name: str) -> None:
        with _temporary_failures():
            self._native.remove(name)

    def open_take(self, name: str) -> WindowTake:
        with _temporary_failures():
            return _BucketTake(f"{self.url}/{name}", self._native.open_take(name))

    def traffic(self) -> tuple[int, int, int]:
        """Requests, bytes received and bytes sent, of this object."""
        return self._native.traffic()


class _BucketTake:
    """A take in a bucket."""

    def __init__(self, url: str, take: RemoteTake) -> None:
        self._url, self._take = url, take
        self.rate_hz, self.n_frames, self.labels = take.rate_hz, take.n_rows, tuple(take.labels)

    def window(self, first: int, stop: int, columns: list[int]) -> npt.NDArray[np.float32]:
        out = np.empty((stop - first, len(columns), 3), dtype=np.float32)
        with _temporary_failures():
            problems = self._take.read_into(out, first, columns)
        for problem in problems:
            warnings.warn(f"{self._url}: {problem}", mocapd.TakeWarning, stacklevel=4)
        return out


@contextmanager
def _temporary_failures() -> Iterator[None]:
    try:
        yield
    except (ConnectionError, TimeoutError) as error:
        raise StoreError(str(error)) from error


def _make_folder(path: Path) -> None:
    """Makes a folder and those above it, which are there after a power cut."""
    if path.is_dir():
        return
    _make_folder(path.parent)
    path.mkdir(exist_ok=True)
    _sync_folder(path.parent)


def _sync_folder(path: Path) -> None:
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    except OSError as error:
        # Some file systems, such as those of Windows in WSL, cannot sync folders.
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(folder)


def _create(path: Path, data: bytes) -> bool:
    """Creates a file that is complete when its name appears, and there after a power cut, unless the name exists."""
    try:
        # A file without a name: if this process is killed, nothing is left of it.
        file = os.open(path.parent, os.O_TMPFILE | os.O_WRONLY, 0o644)
        temporary = None
    except (AttributeError, OSError):
        temporary = path.parent / f".mocapd-{os.getpid()}-{secrets.token_hex(4)}"
        file = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
    try:
        with os.fdopen(file, "wb", closefd=False) as out:
            out.write(data)
        os.fsync(file)
        if temporary is None:
            # With a folder, even one that is not used, Python calls linkat, which follows the link in /proc.
            os.link(f"/proc/self/fd/{file}", path, src_dir_fd=file)
        else:
            os.link(temporary, path)
        _sync_folder(path.parent)
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
    scheme, is_url, rest = text.partition("://")
    if not is_url:
        return FolderStore(text)
    if scheme == "file" and rest.startswith("/"):
        return FolderStore(rest)
    if scheme in ("s3", "gs", "az"):
        return BucketStore(text)
    raise ValueError(f"{text}: expected a folder, or a URL that begins with s3://, gs://, az:// or file:///")
