"""Ingests motion files: imports them on a Ray cluster, stores the takes, and lists them in the catalogue.

Exactly once follows from four facts, and needs nothing from the engine. An import is deterministic; the name of an
object is the hash of all that its bytes depend on; objects are created whole and never replaced; and the driver alone
adds rows, after their objects exist, and only rows that are not there. Whatever is killed, at whatever moment, the same
command completes the archive: the next run imports again what has no row, finds its object, and adds the row.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from .._native import TakeError, TakeFile, import_motion
from ._catalogue import Catalogue, Known, bucket_of, pair_digest
from ._keys import Settings, content_key, object_name, source_hash, tolerance_mm
from ._schema import SCHEMA, MarkerMotion, new_row, take_fields
from ._sources import BATCH_FILES, Names, SourceFile, Sources, batches, find, is_of_file
from ._store import Store, StoreError, open_store
from ._workers import run_tasks

COMMIT_ROWS = 5000
"""Rows of a commit: a Delta table of 10^6 rows then has 200 files, each of about a megabyte."""

COMMIT_S = 60.0
"""Time after which rows are committed although they are fewer: the work that a killed driver loses the rows of."""


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
                self.failed += 1
                if len(self.errors) < 100:
                    self.errors.append((row["source"], row["error"]))

    def __str__(self) -> str:
        rate = self.files / self.seconds if self.seconds else 0.0
        return (
            f"{self.files} files in {self.seconds:.1f} s ({rate:.0f} a second): {self.takes} takes of "
            f"{self.take_bytes / 1e6:.1f} MB from {self.source_bytes / 1e6:.1f} MB ({self.ratio:.1f}:1), "
            f"{self.duplicates} duplicates, {self.unchanged} unchanged, {self.failed} failed"
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
        rows = [row for file in files if (row := self._row(file)) is not None]
        return pa.RecordBatch.from_pylist(rows, SCHEMA)

    def _row(self, file: SourceFile) -> dict[str, Any] | None:
        subject, session = self.names.of(file.source)
        try:
            data = file.read()
        except OSError as error:
            if not is_of_file(error, file):
                raise StoreError(f"cannot read {file.source}: {error}") from error
            if self._is_known(None, file.source):
                return None
            unread = {"subject": subject, "session": session, "format": file.format}
            reason = error.strerror or str(error)
            return new_row("failed", file.source, error=f"cannot be read: {reason}", **unread)
        settings, hashed = self.settings.text(file.format, subject), source_hash(data)
        key = content_key(hashed, settings)
        if self._is_known(key, file.source):
            return None
        fields: dict[str, Any] = {
            "key": key,
            "source_sha256": hashed,
            "source_bytes": len(data),
            "format": file.format,
            "settings": settings,
            "session": session,
        }
        try:
            take, described = self._import(data, file.format, subject)
            name = object_name(key)
            if not self.bucket.put_if_absent(name, take) and self.bucket.size(name) != len(take):
                raise TakeError(f"{name} exists with other bytes: it is damaged, or another importer wrote it")
        except (ValueError, TakeError) as error:
            return new_row("failed", file.source, error=str(error), **{**fields, "subject": subject})
        described["subject"] = described["subject"] or subject
        return new_row("take", file.source, object=name, take_bytes=len(take), **fields, **described)

    def _is_known(self, key: str | None, source: str) -> bool:
        digest = np.bytes_(pair_digest(key, source))
        at = np.searchsorted(self.known, digest)
        return bool(at < len(self.known) and self.known[at] == digest)

    def _import(self, data: bytes, format: str, subject: str | None) -> tuple[bytes, dict[str, Any]]:
        """The take of a source, and the columns that describe it."""
        if format != "take":
            imported = import_motion(data, self.settings.options(format, subject))
            motion = MarkerMotion.of_import(imported)
            return imported.take, take_fields(TakeFile.from_bytes(imported.take), motion, imported.max_error_mm)
        take = TakeFile.from_bytes(data)
        columns = list(range(len(take.labels)))
        positions = np.empty((take.n_rows, len(columns), 3), dtype=np.float32)
        problems = take.read_into(positions, 0, columns, 1)
        problems += take.problems + ([take.cut_off] if take.cut_off is not None else [])
        if problems:
            raise TakeError(f"the take is not whole ({problems[0]}): recover it, and ingest the result")
        error_mm = max((error for *_, error, _ in take.scan(columns, False, 1)[0]), default=0.0)
        motion = MarkerMotion.of_positions(positions, take.header()["rate_hz"])
        return data, take_fields(take, motion, error_mm)


class _Rows:
    """Collects rows, and commits them in batches."""

    def __init__(self, table: Catalogue, known: Known, report: IngestReport) -> None:
        self._table, self._known, self._report = table, known, report
        self._waiting: list[pa.RecordBatch] = []
        self._since = time.monotonic()

    def add(self, batch: pa.RecordBatch) -> None:
        new = self._known.new(batch)
        if new.num_rows:
            self._waiting.append(new)
        n_rows = sum(waiting.num_rows for waiting in self._waiting)
        if n_rows >= COMMIT_ROWS or time.monotonic() - self._since >= COMMIT_S:
            self.commit()

    def commit(self) -> None:
        if self._waiting:
            self._table.append(self._waiting)
            for batch in self._waiting:
                self._report.add(batch)
        self._waiting, self._since = [], time.monotonic()


def ingest(
    sources: Sources,
    bucket: Any = None,
    *,
    tolerance: str | float | None = 0.5,
    resampler: str = "dense",
    effort: int | None = None,
    keys_s: float | None = None,
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
    resampler, effort, keys_s, unit, up, analog_tolerance, drop_foreign
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
        If the store fails repeatedly. What is done is in the catalogue, and the same call continues.
    """
    settings = Settings(
        tolerance_mm(tolerance), resampler, effort, keys_s, unit, up, tuple(analog_tolerance), drop_foreign
    )
    started = time.monotonic()
    store = open_store(bucket_of(bucket))
    table = Catalogue(store)
    files = list(find(sources))
    known, report = Known(table), IngestReport(files=len(files))
    rows = _Rows(table, known, report)
    task = ImportTask(store, settings, Names(names), known.digests())
    tasks = list(batches(files, batch_files))
    with _Progress(len(files), progress) as shown:
        try:
            for index, batch in run_tasks(task.run, tasks, workers):
                report.unchanged += len(tasks[index]) - batch.num_rows
                rows.add(batch)
                shown.update(len(tasks[index]), batch)
        finally:
            rows.commit()
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


