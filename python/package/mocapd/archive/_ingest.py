"""Ingests motion files: imports them on a Ray cluster, stores the takes, and lists them in the catalogue.

Exactly once follows from four facts, and needs nothing from the engine. An import is deterministic; the name of an
object is the hash of all that its bytes depend on; objects are created whole and never replaced; and the driver alone
adds rows, after their objects exist, and only rows that are not there; each commit has a number in the table, and is not
repeated. Whatever is killed, at whatever moment, the same
command completes the archive: the next run imports again what has no row, finds its object, and adds the row.
"""

from __future__ import annotations

import sys
import time
import uuid
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from .._native import TakeError, TakeFile, import_motion, measure_take
from ._catalogue import Catalogue, Known, bucket_of, pair_digest
from ._keys import Settings, content_key, key_seconds, object_name, source_hash, to_json, tolerance_mm
from ._lease import writing
from ._schema import SCHEMA, new_row, take_fields
from ._sources import BATCH_FILES, Names, SourceFile, Sources, batches, find, is_of_file, is_of_machine
from ._store import FolderStore, Store, StoreError, open_store
from ._workers import ended_process, run_tasks

COMMIT_ROWS = 5000
"""Rows of a commit: a Delta table of 10^6 rows then has 200 files, each of about a megabyte."""

COMMIT_S = 60.0
"""Time after which fewer rows are committed: a killed driver loses those of a minute, and a repack's new objects have rows
before they are old enough to be collected."""

SYNCS_MAX = 4
"""Takes that a worker stores in a folder at a time, while it imports the next files: to sync a file takes about as long as an
import, and needs little of a processor. Files that are synced together share a commit of the disk's journal. A bucket gets
one at a time, so that workers do not wait for each other at a store that is busy."""


@dataclass
class IngestReport:
    """What an ingest did."""

    files: int = 0
    """Files that were found."""
    takes: int = 0
    """New takes in the catalogue."""
    duplicates: int = 0
    """Files with the bytes and settings of another one."""
    failed: int = 0
    """Files with an error that the catalogue did not have yet."""
    unchanged: int = 0
    """Files that have a row from a former ingest."""
    failed_before: int = 0
    """Of these, files that failed then, and were not tried again."""
    source_bytes: int = 0
    """Of the new takes."""
    take_bytes: int = 0
    seconds: float = 0.0
    errors: list[tuple[str, str]] = field(default_factory=list)
    """The first hundred of the files that failed, with their errors."""

    @property
    def ratio(self) -> float:
        return self.source_bytes / self.take_bytes if self.take_bytes else 0.0

    def add(self, batch: pa.RecordBatch) -> None:
        for row in batch.select(["status", "source", "source_bytes", "take_bytes", "error"]).to_pylist():
            if row["status"] == "take":
                self.takes += 1
                self.source_bytes += row["source_bytes"]
                self.take_bytes += row["take_bytes"]
            elif row["status"] == "duplicate":
                self.duplicates += 1
            else:
                self.fail(row["source"], row["error"])

    def fail(self, source: str, error: str) -> None:
        self.failed += 1
        if len(self.errors) < 100:
            self.errors.append((source, error))

    def __str__(self) -> str:
        rate = self.files / self.seconds if self.seconds else 0.0
        return (
            f"{self.files} files in {self.seconds:.1f} s ({rate:.0f} a second): {self.takes} takes of "
            f"{self.take_bytes / 1e6:.1f} MB from {self.source_bytes / 1e6:.1f} MB ({self.ratio:.1f}:1), "
            f"{self.duplicates} duplicates, {self.unchanged} unchanged, {self.failed} failed, {self.failed_before} failed before"
        )


@dataclass(frozen=True)
class ImportTask:
    """What a worker needs besides the files: pickled once, and shared by all tasks."""

    bucket: Store
    settings: Settings
    names: Names
    known: npt.NDArray[np.bytes_]

    def run(self, files: list[SourceFile]) -> pa.RecordBatch:
        """Imports files, and stores their takes. Returns a row for each that has none yet."""
        if isinstance(self.bucket, FolderStore):
            rows = self._stored_ahead(files)
        else:
            # In this thread, in which Ctrl-C ends an upload.
            rows = [row for file in files if (row := self._stored(*self._row(file))) is not None]
        try:
            return pa.RecordBatch.from_pylist(rows, SCHEMA)
        except MemoryError as error:
            # Also an ArrowException.
            raise StoreError(f"no memory for {len(rows)} rows: {error}") from error
        except (pa.ArrowException, OverflowError):
            # A number in one of them, such as a count of a hostile take, has no place in its column.
            return pa.RecordBatch.from_pylist([_representable(row) for row in rows], SCHEMA)

    def lost(self, file: SourceFile, reason: str) -> pa.RecordBatch:
        """The row of a file whose import ends each worker."""
        error = ended_process("its import", reason)
        is_known = self._is_known(None, file.source)
        return pa.RecordBatch.from_pylist([] if is_known else [self._failed(file, error)], SCHEMA)

    def _row(self, file: SourceFile) -> tuple[dict[str, Any] | None, bytes]:
        """The row of a file, None if it has one, and its take; of one that cannot be imported, a row with the error."""
        try:
            return self._imported(file)
        except StoreError:
            raise
        except Exception as error:
            if not is_of_file(error, file.store):
                raise StoreError(f"cannot read {file.source}: {_text(error)}") from error
            return self._failed(file, f"cannot be imported: {_reason(error)}"), b""

    def _stored_ahead(self, files: list[SourceFile]) -> list[dict[str, Any]]:
        """Imports files, and stores their takes while the next ones are imported. Returns the rows."""
        rows: list[dict[str, Any] | None] = []
        with ThreadPoolExecutor(SYNCS_MAX) as pool:
            storing: deque[Future[dict[str, Any] | None]] = deque()
            for file in files:
                row, take = self._row(file)
                if row is None:
                    continue
                try:
                    storing.append(pool.submit(self._stored, row, take))
                except (RuntimeError, MemoryError) as error:
                    # No new thread. What was submitted may yet be stored, and is found by the next attempt.
                    raise StoreError(f"cannot store the take of {row['source']} on this machine: {_text(error)}") from error
                if len(storing) > SYNCS_MAX:
                    rows.append(storing.popleft().result())
            rows += [stored.result() for stored in storing]
        return [row for row in rows if row is not None]

    def _stored(self, row: dict[str, Any] | None, take: bytes) -> dict[str, Any] | None:
        """Stores the take of a row. Returns the row."""
        if row is None or row["status"] != "take":
            return row
        try:
            self.bucket.put_if_absent(row["object"], take)
            return row
        except FileExistsError as error:
            # Of the archive, and not of the file: no row.
            return new_row("damaged", row["source"], error=f"{error}: remove this object if it is damaged")
        except (OSError, MemoryError) as error:
            raise StoreError(f"cannot write {row['object']} of {row['source']}: {_text(error)}") from error

    def _failed(self, file: SourceFile, error: str, **fields: Any) -> dict[str, Any]:
        subject, session = self.names.of(file.source)
        described = {"subject": subject, "session": session, "format": file.format}
        return new_row("failed", file.source, error=error, **described | fields)

    def _imported(self, file: SourceFile) -> tuple[dict[str, Any] | None, bytes]:
        try:
            data = file.read()
        except Exception as error:
            if isinstance(error, StoreError) or not is_of_file(error, file.store):
                raise
            is_known = self._is_known(None, file.source)
            return None if is_known else self._failed(file, f"cannot be read: {_reason(error)}"), b""
        subject, session = self.names.of(file.source)
        settings, hashed = self.settings.document(file.format, subject), source_hash(data)
        key = content_key(hashed, settings)
        if self._is_known(key, file.source):
            return None, b""
        fields: dict[str, Any] = {
            "key": key,
            "source_sha256": hashed,
            "source_bytes": len(data),
            "format": file.format,
            "settings": to_json(settings),
            "session": session,
        }
        if self._has_digest(key[:32].encode()):
            return new_row("duplicate", file.source, **fields, subject=subject), b""
        try:
            take, described = self._import(data, file.format, subject)
        except Exception as error:
            # A source is bytes in memory, and wrong ones are no OSError: that is of temporary files and threads.
            if is_of_machine(error) or (isinstance(error, OSError) and file.format != "take"):
                raise StoreError(f"cannot import {file.source} on this machine: {_text(error)}") from error
            return self._failed(file, _reason(error), **fields), b""
        described["subject"] = described["subject"] or subject
        stored = {"object": object_name(key), "take_bytes": len(take), "take_sha256": source_hash(take)}
        return new_row("take", file.source, **stored, **fields, **described), take

    def _is_known(self, key: str | None, source: str) -> bool:
        return self._has_digest(pair_digest(key, source))

    def _has_digest(self, digest: bytes) -> bool:
        at = np.searchsorted(self.known, np.bytes_(digest))
        return bool(at < len(self.known) and self.known[at] == digest)

    def _import(self, data: bytes, format: str, subject: str | None) -> tuple[bytes, dict[str, Any]]:
        """The take of a source, and the columns that describe it."""
        if format != "take":
            imported = import_motion(data, self.settings.options(format, subject))
            return imported.take, take_fields(TakeFile.from_bytes(imported.take), imported)
        take = TakeFile.from_bytes(data)
        measured, problems = measure_take(data)
        problems += take.problems + ([take.cut_off] if take.cut_off is not None else [])
        if problems:
            raise TakeError(f"the take is not whole ({problems[0]}): recover it, and ingest the result")
        return data, take_fields(take, measured)


def _representable(row: dict[str, Any]) -> dict[str, Any]:
    try:
        pa.RecordBatch.from_pylist([row], SCHEMA)
        return row
    except (pa.ArrowException, OverflowError) as error:
        if isinstance(error, MemoryError):
            raise
        kept = ("key", "source_sha256", "source_bytes", "format", "settings", "session")
        fields = {name: row.get(name) for name in kept}
        return new_row("failed", row["source"], error=f"its description cannot be stored: {error}", **fields)


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error)
    return str(text or type(error).__name__)


def _text(error: Exception) -> str:
    """An error with its file, where it has one; that of missing memory says nothing itself."""
    return str(error) or "out of memory"


def _n_rows(batches: list[pa.RecordBatch]) -> int:
    return sum(batch.num_rows for batch in batches)


class _Rows:
    """Collects rows, and commits them in batches."""

    def __init__(self, table: Catalogue, known: Known, report: IngestReport) -> None:
        self._table, self._known, self._report = table, known, report
        self._waiting: list[pa.RecordBatch] = []
        self._since = time.monotonic()
        self._run, self._commits = str(uuid.uuid4()), 0

    def add(self, batch: pa.RecordBatch) -> None:
        damaged = batch.filter(pc.equal(batch.column("status"), "damaged"))
        for row in damaged.to_pylist():
            self._report.fail(row["source"], row["error"])
        new = self._known.new(batch)
        self._report.unchanged += batch.num_rows - damaged.num_rows - _n_rows(new)
        self._waiting += new
        if _n_rows(self._waiting) >= COMMIT_ROWS or time.monotonic() - self._since >= COMMIT_S:
            self.commit()

    def commit(self) -> None:
        # Taken first: rows of a commit that failed are not committed again by who handles its error.
        waiting, self._waiting, self._since = self._waiting, [], time.monotonic()
        if waiting:
            self._commits += 1
            added = self._table.append(waiting, self._run, self._commits, self._known)
            # Another ingest added the others meanwhile.
            self._report.unchanged += _n_rows(waiting) - _n_rows(added)
            for batch in added:
                self._report.add(batch)
        moved, self._known.moved = self._known.moved, []
        self._table.move(moved)


def ingest(
    sources: Sources,
    bucket: Any = None,
    *,
    tolerance: str | float | None = 0.5,
    resampler: str = "dense",
    effort: int | None = None,
    keys: str | float | None = None,
    unit: str | None = None,
    up: str | None = None,
    analog_tolerance: tuple[str, ...] = (),
    drop_foreign: bool = False,
    names: str | None = None,
    workers: int | None = None,
    batch_files: int = BATCH_FILES,
    progress: bool = True,
) -> IngestReport:
    """Imports motion files and takes into an archive, each once.

    Parameters
    ----------
    sources
        Files, and folders with all that is in them, as paths or URLs: ``.c3d``, ``.trc``, ``.tsv``, ``.csv``, ``.take``.
    bucket
        The archive: a folder or a URL; by default the one that ``MOCAPD_ARCHIVE`` names.
    tolerance
        Largest distance between a sample and its reconstruction: ``"0.5mm"``, ``"100um"``, or a number of millimetres.
        None with a lossless resampler.
    resampler, effort, keys, unit, up, analog_tolerance, drop_foreign
        As the options of ``mocapd import``.
    names
        A regular expression with groups ``(?P<subject>...)`` and ``(?P<session>...)``, searched in the names of sources.
        The subject is part of the take.
    workers
        Ray workers at a time; by default one for each core of the cluster. 0 imports in this process, without Ray.
    batch_files
        Files of a task.
    progress
        Whether to show progress on standard error.

    Raises
    ------
    FileNotFoundError, ValueError
        For a source that does not exist, or invalid settings. A file that cannot be imported is no exception, but a row
        with its error.
    StoreError
        If the store fails repeatedly, or other processes commit first each time. What is done is in the catalogue, and the
        same call continues.
    """
    settings = Settings(
        tolerance_mm(tolerance), resampler, effort, key_seconds(keys), unit, up, tuple(analog_tolerance), drop_foreign
    )
    started = time.monotonic()
    store = open_store(bucket_of(bucket))
    table = Catalogue(store)
    files = list(find(sources, store))
    with writing(store):
        known, report = Known(table), IngestReport(files=len(files))
        failed_before = known.failed & {file.source for file in files}
        rows = _Rows(table, known, report)
        task = ImportTask(store, settings, Names(names), known.digests())
        with _Progress(len(files), progress) as shown:
            try:
                for done, batch in run_tasks(task.run, list(batches(files, batch_files)), workers, task.lost):
                    report.unchanged += len(done) - batch.num_rows
                    rows.add(batch)
                    shown.update(len(done), batch)
            finally:
                rows.commit()
    report.failed_before = len(failed_before & known.failed)
    report.seconds = time.monotonic() - started
    return report


class _Progress:
    """The progress bar: files a second, bytes, ratio and failures."""

    def __init__(self, n_files: int, is_shown: bool) -> None:
        from tqdm import tqdm

        self._bar = tqdm(total=n_files, unit=" files", disable=not is_shown, file=sys.stderr)
        self._bytes = [0, 0]
        self._failed = 0

    def __enter__(self) -> _Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def update(self, n_files: int, batch: pa.RecordBatch) -> None:
        for at, name in enumerate(("source_bytes", "take_bytes")):
            self._bytes[at] += sum(filter(None, batch.column(name).to_pylist()))
        self._failed += batch.column("status").to_pylist().count("failed")
        read, written = self._bytes
        self._bar.set_postfix_str(
            f"{read / 1e6:.1f} MB to {written / 1e6:.1f} MB, {read / max(written, 1):.1f}:1, {self._failed} failed", False
        )
        self._bar.update(n_files)


