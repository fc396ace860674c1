"""Upkeep of an archive: every take verified, takes written again in fewer bytes, objects removed that no row names."""

from __future__ import annotations

import errno
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from .._native import TakeError, TakeFile, check_take, repack_take
from ._catalogue import Catalogue, bucket_of
from ._ingest import COMMIT_ROWS, COMMIT_S
from ._keys import object_key, object_name, source_hash
from ._lease import DEAD_S, leases, writing
from ._sources import BATCH_FILES, is_of_file, is_of_machine
from ._store import Entry, FolderStore, Store, StoreError, open_store
from ._workers import ended_process, run_tasks

YOUNG_S = 24 * 3600.0
"""Age below which :func:`collect` leaves an object, and time for which it leaves one that a row named: what reads an older
version of the table, such as an epoch of training, has a day to end."""


@dataclass
class VerifyReport:
    """What is wrong with an archive."""

    takes: int = 0
    n_bytes: int = 0
    damaged: list[tuple[str, str]] = field(default_factory=list)
    """Objects, and what is wrong with each, or why it could not be read or verified."""
    missing: list[str] = field(default_factory=list)
    """Objects that rows name, but that do not exist."""
    unlisted: list[str] = field(default_factory=list)
    """Objects that no row names. The next ingest of their sources adds their rows, or :func:`collect` removes them."""

    @property
    def is_intact(self) -> bool:
        return not self.damaged and not self.missing

    def __str__(self) -> str:
        return (
            f"{self.takes} takes of {self.n_bytes / 1e6:.1f} MB: {len(self.damaged)} damaged, {len(self.missing)} missing, "
            f"{len(self.unlisted)} not in the catalogue"
        )


def _unreadable(store: Store, name: str, error: OSError) -> str:
    """What is wrong with a take that cannot be read, or a StoreError if it is the store."""
    # A bad sector of a disk has the error of a share that is gone; of that, every take is listed.
    if is_of_file(error, store) or (error.errno == errno.EIO and isinstance(store, FolderStore)):
        return f"cannot be read: {error.strerror or error}"
    raise StoreError(f"cannot read {name}: {error}") from error


@dataclass(frozen=True)
class _Verify:
    bucket: Store

    def run(self, rows: Sequence[dict[str, Any]]) -> list[tuple[str, int | None, str | None]]:
        """For each row the object, its size, None if it is missing, and what is wrong."""
        found: list[tuple[str, int | None, str | None]] = []
        for row in rows:
            try:
                data = self.bucket.get(row["object"])
            except FileNotFoundError:
                found.append((row["object"], None, None))
                continue
            except OSError as error:
                found.append((row["object"], 0, _unreadable(self.bucket, row["object"], error)))
                continue
            found.append((row["object"], len(data), self._problem(row, data)))
        return found

    @staticmethod
    def lost(row: dict[str, Any], reason: str) -> list[tuple[str, int | None, str | None]]:
        return [(row["object"], 0, ended_process("its verification", reason))]

    @staticmethod
    def _problem(row: dict[str, Any], data: bytes) -> str | None:
        if len(data) != row["take_bytes"]:
            return f"it has {len(data)} bytes, and {row['take_bytes']} in the catalogue"
        try:
            problems = check_take(data)
            take = TakeFile.from_bytes(data)
            present = (take.ledger() or {}).get("samples_present")
        except (TakeError, ValueError, OSError) as error:
            if is_of_machine(error):
                raise StoreError(f"cannot verify {row['object']} on this machine: {error}") from error
            return str(error)
        if problems:
            return problems[0]
        if source_hash(data) != row["take_sha256"]:
            return "its bytes are not those in the catalogue"
        if (take.n_rows, len(take.labels), present) != (row["frames"], row["markers"], row["samples"]):
            return "its frames, markers or samples are not those in the catalogue"
        return None


def verify(bucket: Any = None, *, workers: int | None = None) -> VerifyReport:
    """Reads every take of an archive whole, decodes it, and compares it with its row. One that cannot be read is listed
    as damaged, and the others follow.
    """
    store = open_store(bucket_of(bucket))
    table = Catalogue(store)
    table.existing()
    columns = ["status", "object", "take_bytes", "take_sha256", "frames", "markers", "samples"]
    listed = table.arrow(columns).to_pylist()
    # Two rows of a take are those of two ingests at once.
    rows = list({row["object"]: row for row in listed if row["status"] == "take"}.values())
    report = VerifyReport(takes=len(rows))
    report.unlisted = sorted({entry.name for entry in store.list("takes/")} - {row["object"] for row in listed})
    for _, found in run_tasks(_Verify(store).run, _groups(rows), workers, _Verify.lost):
        for name, n_bytes, problem in found:
            report.n_bytes += n_bytes or 0
            if n_bytes is None:
                report.missing.append(name)
            elif problem is not None:
                report.damaged.append((name, problem))
    report.damaged.sort()
    report.missing.sort()
    return report


@dataclass
class RepackReport:
    """What a repack of an archive did."""

    takes: int = 0
    repacked: int = 0
    bytes_before: int = 0
    bytes_after: int = 0
    failed: list[tuple[str, str]] = field(default_factory=list)

    def __str__(self) -> str:
        return (
            f"{self.repacked} of {self.takes} takes repacked: {self.bytes_before / 1e6:.1f} MB before, "
            f"{self.bytes_after / 1e6:.1f} MB now, {len(self.failed)} failed"
        )


@dataclass(frozen=True)
class _Repack:
    bucket: Store

    def run(self, rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """The rows, with the new object and its size, or with an error."""
        return [row | self._repack(row) for row in rows]

    @staticmethod
    def lost(row: dict[str, Any], reason: str) -> list[dict[str, Any]]:
        return [row | {"error": ended_process("its repack", reason)}]

    def _repack(self, row: dict[str, Any]) -> dict[str, Any]:
        try:
            data = self.bucket.get(row["object"])
        except FileNotFoundError as error:
            return {"error": str(error)}
        except OSError as error:
            return {"error": _unreadable(self.bucket, row["object"], error)}
        try:
            new = repack_take(data)
        except (TakeError, ValueError) as error:
            return {"error": str(error)}
        if new is None:
            return {"error": None}
        name = object_name(row["key"], source_hash(new))
        try:
            self.bucket.put_if_absent(name, new)
        except FileExistsError as error:
            # Of a repack that did not end, and damaged since.
            return {"error": f"{error}: remove this object if it is damaged"}
        except OSError as error:
            raise StoreError(f"cannot write {name}: {error}") from error
        return {"error": None, "new": name, "new_bytes": len(new), "new_sha256": source_hash(new)}


def repack(bucket: Any = None, *, workers: int | None = None) -> RepackReport:
    """Writes the takes of an archive again in fewer bytes, as ``mocapd repack`` does: what a take decodes to stays the
    same, bit for bit, and is compared. A smaller take is a new object, which its row then names; :func:`collect` removes
    the old one.
    """
    store = open_store(bucket_of(bucket))
    table = Catalogue(store)
    table.existing()
    rows = table.arrow(["status", "key", "object", "take_bytes"]).to_pylist()
    rows = list({row["object"]: row for row in rows if row["status"] == "take"}.values())
    report = RepackReport(takes=len(rows))
    changed: list[dict[str, Any]] = []
    with writing(store):
        since = time.monotonic()
        try:
            for _, found in run_tasks(_Repack(store).run, _groups(rows), workers, _Repack.lost):
                for row in found:
                    report.bytes_before += row["take_bytes"]
                    report.bytes_after += row.get("new_bytes", row["take_bytes"])
                    if row["error"] is not None:
                        report.failed.append((row["object"], row["error"]))
                    elif "new" in row:
                        changed.append(row)
                        report.repacked += 1
                if len(changed) >= COMMIT_ROWS or time.monotonic() - since >= COMMIT_S:
                    moving, changed, since = changed, [], time.monotonic()
                    table.move(moving)
        finally:
            table.move(changed)
    return report


def collect(
    bucket: Any = None, *, remove: bool = False, older_than_s: float = YOUNG_S, ignore_leases: bool = False
) -> list[Entry]:
    """The takes that no row of the catalogue names: of an ingest that was interrupted and not repeated, of rows that were
    deleted, and those that a repack replaced. With ``remove`` they are removed; former versions of the table then name
    takes that do not exist.

    Takes of less than this age are left out, and those that a version of the table named within this time, because what
    was read from it may still be used.

    Raises
    ------
    StoreError
        If they are to be removed while an ingest or repack is running, or after one was killed less than an hour ago.
        ``ignore_leases`` removes them nevertheless: only if none is running.
    """
    store = open_store(bucket_of(bucket))
    table = Catalogue(store)
    table.existing()
    if remove and not ignore_leases:
        _refuse_leases(store)
    entries = [entry for entry in store.list("takes/") if object_key(entry.name)]
    # Read after the list: rows are added after their objects exist.
    named = table.named_objects(older_than_s)
    now_s = time.time()

    def is_old(entry: Entry) -> bool:
        return entry.modified_s is not None and now_s - entry.modified_s >= older_than_s

    found = [entry for entry in entries if entry.name not in named and is_old(entry)]
    if remove:
        if not named and found:
            raise StoreError("no row names a take, so nothing is removed: remove the bucket if it is not needed")
        if not ignore_leases:
            # One that began while takes and rows were listed may name some of them soon.
            _refuse_leases(store)
        for entry in found:
            store.remove(entry.name)
    return found


def _refuse_leases(store: Store) -> None:
    if held := leases(store):
        raise StoreError(
            f"an ingest or a repack is running ({', '.join(entry.name for entry in held)}), or was killed less than "
            f"{DEAD_S / 60:.0f} min ago: wait for it, or ignore its lease (--ignore-leases) if none is running"
        )


def _groups(rows: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    return [rows[first : first + BATCH_FILES] for first in range(0, len(rows), BATCH_FILES)]
