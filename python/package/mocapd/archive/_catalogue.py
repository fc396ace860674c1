"""The catalogue of an archive: a Delta table with a row for each source that was ingested."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from itertools import count
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
from deltalake import CommitProperties, DeltaTable, QueryBuilder, Transaction, write_deltalake
from deltalake.exceptions import CommitFailedError, DeltaError, TableNotFoundError

from ._keys import source_hash
from ._schema import SCHEMA
from ._store import FolderStore, Store, StoreError, open_store
from ._workers import call, wait_at_random

FOLDER = "catalogue"
"""The folder of the table in the bucket."""

BUCKET_VARIABLE = "MOCAPD_ARCHIVE"
"""The environment variable with the bucket of the archive, where none is given."""

CONFLICTS_MAX = 30
"""Repetitions of a commit that another one has preceded: the store works, and another process has made progress. So many in
a row, in about a minute of waits, say that too many processes write one table."""


def bucket_of(bucket: str | os.PathLike[str] | Store | None) -> str | os.PathLike[str] | Store:
    """The bucket, or the one of the environment."""
    if bucket is not None:
        return bucket
    found = os.environ.get(BUCKET_VARIABLE)
    if not found:
        raise ValueError(f"no archive is given: pass its bucket, or set {BUCKET_VARIABLE}")
    return found


def catalogue(bucket: str | os.PathLike[str] | Store | None = None, *, version: int | None = None) -> Catalogue:
    """Opens the catalogue of an archive; ``version`` is a former version of the table."""
    return Catalogue(open_store(bucket_of(bucket)), version)


class Catalogue:
    """The rows of an archive, which the drivers of ingests and repacks write."""

    def __init__(self, store: Store, version: int | None = None) -> None:
        self.store = store
        if "%" in store.url:
            raise ValueError(f"{store.url}: deltalake misreads names with %: choose another for the archive")
        root = Path(store.url.removeprefix("file://")).as_uri() if isinstance(store, FolderStore) else store.url
        self.url = f"{root.rstrip('/')}/{FOLDER}"
        self._version = version
        self._options = _delta_options(self.url)

    def delta(self) -> DeltaTable | None:
        """The Delta table, newly opened; None if nothing was ingested yet."""
        try:
            return DeltaTable(self.url, version=self._version, storage_options=self._options)
        except TableNotFoundError:
            return None

    def arrow(self, columns: Iterable[str] | None = None) -> pa.Table:
        """The whole table, or some columns of it."""
        return _read_or_empty(self.delta(), list(columns) if columns is not None else SCHEMA.names)

    def sql(self, query: str) -> pa.Table:
        """The result of a query by DataFusion. The table is ``catalogue``; ``takes`` has only its takes, ``latest`` the last
        take of each source, once where sources share it, and ``failures`` the sources that failed and have no take.

        Raises
        ------
        FileNotFoundError
            If there is no archive.
        ValueError
            For a query that is not valid.
        """
        context = QueryBuilder().register("catalogue", self.existing())
        for name, view in VIEWS.items():
            context.execute(f"create view {name} as {view}")
        try:
            found = pa.table(context.execute(query).read_all())
        except DeltaError as error:
            raise ValueError(f"the query cannot be run: {error}") from error
        return found.cast(pa.schema([field.with_type(_without_views(field.type)) for field in found.schema]))

    def existing(self) -> DeltaTable:
        """The Delta table.

        Raises
        ------
        FileNotFoundError
            If there is none.
        """
        table = self.delta()
        if table is None:
            raise FileNotFoundError(2, "no archive, because nothing was ingested there: check the name", self.store.url)
        return table

    def named_objects(self, within_s: float) -> set[str]:
        """The objects that rows name, or named within this time."""
        table = self.existing()
        named = set(_read(table, ["object"]).column("object").to_pylist())
        since_ms = (time.time() - within_s) * 1000
        # An append leaves all rows there are.
        changes = [entry for entry in table.history() if entry["operation"] not in ("WRITE", "CREATE TABLE")]
        changes = [entry for entry in changes if entry["timestamp"] >= since_ms and entry["version"]]
        # What rows named when the time began, and before each deletion. Objects that a repack replaced later are young.
        versions = {min((entry["version"] for entry in changes), default=0)}
        versions |= {entry["version"] for entry in changes if entry["operation"] == "DELETE"}
        for version in versions - {0}:
            before = DeltaTable(self.url, version=version - 1, storage_options=self._options)
            # Nobody can read a version whose files were vacuumed.
            with suppress(FileNotFoundError):
                named.update(_read(before, ["object"]).column("object").to_pylist())
        return named - {None}

    def append(
        self, batches: list[pa.RecordBatch], run: str, number: int, known: Known | None = None
    ) -> list[pa.RecordBatch]:
        """Commits rows once: the commit with this number of a run. They are in the table, all of them, when this returns.

        With ``known``, rows that the table has meanwhile from another process are left out. Returns those that were added.
        """
        # Without retries, no other commit comes between the reading of the table and this one.
        properties = CommitProperties(app_transactions=[Transaction(run, number)], max_commit_retries=0)
        added = batches

        def write(existing: DeltaTable | None) -> None:
            nonlocal added
            # The table states which commits of a run it has, so that one whose answer was lost is not repeated.
            if existing is not None and existing.transaction_version(run) == number:
                return
            if existing is None:
                # Without rows: if another process has just created the table, this commit fails, and one with rows would not.
                existing = DeltaTable.create(self.url, SCHEMA, name=NAME, configuration=KEPT, storage_options=self._options)
            elif known is not None and known.version != existing.version():
                added = known.renewed(existing, added)
            if not added:
                return
            version = int(existing.version()) + 1
            rows = pa.Table.from_batches(added, SCHEMA)
            write_deltalake(existing, rows, mode="append", storage_options=self._options, commit_properties=properties)
            if known is not None:
                known.version = version

        self._commit(write)
        return added

    def move(self, rows: list[dict[str, Any]]) -> None:
        """Commits new objects of takes: rows with ``object``, ``new``, ``new_bytes`` and ``new_sha256``."""
        rows = list({row["object"]: row for row in rows}.values())
        if not rows:
            return
        names = ("object", "new", "new_bytes", "new_sha256")
        moved = pa.table({name: [row[name] for row in rows] for name in names})

        def merge(existing: DeltaTable | None) -> None:
            assert existing is not None
            merge = existing.merge(moved, "old.object = moved.object", source_alias="moved", target_alias="old")
            changed = {"object": "moved.new", "take_bytes": "moved.new_bytes", "take_sha256": "moved.new_sha256"}
            # A duplicate has only the object.
            merge.when_matched_update(changed, "old.status = 'take'").when_matched_update({"object": "moved.new"}).execute()

        self._commit(merge)

    def delete(self, where: str) -> int:
        """Removes the rows for which an SQL condition holds, such as ``importer < 2``; former versions of the table keep
        them. Their objects stay until :func:`collect` removes them. Returns the number of rows.
        """
        return int(self.existing().delete(where)["num_deleted_rows"])

    def retire(self, importer: int) -> int:
        """Removes the rows of takes that former importers made, where this importer or a later one has made a take of each of
        their sources, of the same bytes and with the same settings. Returns the number of rows.
        """
        columns = ["status", "key", "source", "source_sha256", "settings", "importer"]
        rows = self.arrow(columns).to_pylist()
        has_take = {row["key"] for row in rows if row["status"] == "take"}
        # What was imported: the take of other bytes or settings replaces none.
        imported = itemgetter("source", "source_sha256", "settings")
        rows = [row for row in rows if row["key"] in has_take and row["importer"] is not None]
        renewed = {imported(row) for row in rows if row["importer"] >= importer}
        old = [row for row in rows if row["importer"] < importer]
        needed = {row["key"] for row in old if imported(row) not in renewed}
        retired = [row["key"] for row in old if row["key"] not in needed]
        keys = pa.table({"key": pa.array(sorted(set(retired)), pa.string())})
        if keys.num_rows:

            def remove(existing: DeltaTable | None) -> None:
                assert existing is not None
                merge = existing.merge(keys, "old.key = retired.key", source_alias="retired", target_alias="old")
                merge.when_matched_delete("old.status <> 'failed'").execute()

            self._commit(remove)
        return len(retired)

    def _commit(self, write: Callable[[DeltaTable | None], None]) -> None:
        """Calls ``write`` with the newest table, again if another process has committed meanwhile or the store fails."""

        def once(_: None) -> None:
            try:
                write(self.delta())
            except CommitFailedError:
                raise
            except (DeltaError, OSError) as error:
                raise StoreError(f"cannot write the catalogue {self.url}: {error}") from error

        # Conflicts have attempts of their own: with those of the store, a few ingests at once would stop each other.
        for conflicts in count():
            try:
                call(once, None)
                return
            except CommitFailedError as error:
                if conflicts == CONFLICTS_MAX:
                    raise StoreError(
                        f"cannot write the catalogue {self.url}: other processes have committed first {conflicts + 1} times "
                        f"in a row ({error}): run fewer at once"
                    ) from error
            wait_at_random(conflicts)


def _version(table: DeltaTable | None) -> int:
    """The version of the table, from 0; -1 if there is none."""
    return -1 if table is None else int(table.version())


def _read_or_empty(table: DeltaTable | None, names: list[str]) -> pa.Table:
    return pa.schema([SCHEMA.field(name) for name in names]).empty_table() if table is None else _read(table, names)


def _read(table: DeltaTable, names: list[str]) -> pa.Table:
    """Columns of all rows, by DataFusion: pyarrow's threads call Python, and abort a program that ends meanwhile.

    Raises
    ------
    FileNotFoundError
        If a file of this version was vacuumed.
    """
    columns = ", ".join(f'"{name}"' for name in names)
    try:
        found = QueryBuilder().register("catalogue", table).execute(f"select {columns} from catalogue").read_all()
    except Exception as error:  # deltalake has no narrower class for errors of reading
        is_missing = "Object at location" in str(error) and "not found" in str(error)
        raise (FileNotFoundError if is_missing else StoreError)(f"cannot read the catalogue: {error}") from error
    return pa.table(found).cast(pa.schema([SCHEMA.field(name) for name in names]))


VIEWS = {
    "takes": "select * from catalogue where status = 'take'",
    "latest": "select * from takes where key in (select key from (select key, row_number() over (partition by source "
    "order by ingested desc) as newest from catalogue where status <> 'failed') where newest = 1)",
    "failures": "select source, error, ingested from catalogue where status = 'failed' and source not in "
    "(select source from catalogue where status <> 'failed')",
}

NAME = "catalogue of a mocapd archive"

KEPT = {"delta.logRetentionDuration": "interval 36500 days"}
"""Former versions stay: without this, deltalake removes those of more than 30 days."""


def _without_views(kind: pa.DataType) -> pa.DataType:
    """DataFusion's texts are views, which other libraries do not know everywhere."""
    if pa.types.is_string_view(kind):
        return pa.string()
    if pa.types.is_list(kind):
        return pa.list_(_without_views(kind.value_type))
    if pa.types.is_struct(kind):
        return pa.struct([field.with_type(_without_views(field.type)) for field in kind])
    return kind


def _delta_options(url: str) -> dict[str, str]:
    """What ``deltalake`` needs besides the environment, which it reads as mocapd does."""
    endpoints = (os.environ.get(f"AWS_{name}", "") for name in ("ENDPOINT_URL", "ENDPOINT_URL_S3", "ENDPOINT"))
    if url.startswith("s3://") and any(endpoint.startswith("http://") for endpoint in endpoints):
        return {"AWS_ALLOW_HTTP": "true"}
    return {}


class Known:
    """The rows that exist, to which an ingest only adds. Rows of takes whose objects are lost count as none."""

    def __init__(self, table: Catalogue) -> None:
        self.moved: list[dict[str, Any]] = []
        """Objects of takes that are there again, under another name than in their rows."""
        self.failed: set[str] = set()
        """Sources that have failed, and have no take."""
        self._lost: dict[str | None, str] = {}
        self._of_lost: set[tuple[str | None, str]] = set()
        existing = table.delta()
        self.version = _version(existing)
        """Of the table that is known: -1 if there is none."""
        rows = _read_or_empty(existing, ["status", "key", "source", "object", "take_bytes"])
        # Listed after the rows are read: an object precedes its row.
        n_bytes = {entry.name: entry.n_bytes for entry in table.store.list("takes/")} if rows.num_rows else {}
        found = list(zip(*(rows.column(name).to_pylist() for name in rows.column_names)))
        self._objects = {key: name for status, key, _, name, size in found if status == "take" and n_bytes.get(name) == size}
        self._pairs = set()
        for status, key, source, name, _ in found:
            if status == "failed" or key in self._objects:
                self._pairs.add((key, source))
            elif status == "take":
                self._lost[key] = name
        for status, key, source, *_ in found:
            if key in self._lost:
                self._of_lost.add((key, source))
            if status == "failed":
                self.failed.add(source)
        self.failed.difference_update(source for status, _, source, *_ in found if status != "failed")

    def digests(self) -> npt.NDArray[np.bytes_]:
        """What workers need to skip the files that have a row, and to import no bytes twice: sorted, of each pair and of each
        key 16 bytes in hexadecimal."""
        pairs = [pair_digest(key, source) for key, source in self._pairs]
        return np.sort(np.array(pairs + [key[:32].encode() for key in self._objects], dtype="S32"))

    def new(self, batch: pa.RecordBatch) -> list[pa.RecordBatch]:
        """The rows of a batch that are new. A take that has the key of another one becomes a duplicate."""
        # Only these columns are read here: rows of Python objects would cost a fifth of the import.
        names = ("status", "key", "source", "object", "take_bytes", "take_sha256")
        rows = zip(*(batch.column(name).to_pylist() for name in names))
        kept: list[int] = []
        duplicates: list[int] = []
        for index, (status, key, source, name, n_bytes, sha256) in enumerate(rows):
            pair = key, source
            if pair in self._pairs or status == "damaged":
                continue
            self._pairs.add(pair)
            if status != "failed":
                self.failed.discard(source)
            if status == "take" and (lost := self._lost.pop(key, None)) is not None:
                self._objects[key] = name
                if lost != name:
                    self.moved.append({"object": lost, "new": name, "new_bytes": n_bytes, "new_sha256": sha256})
            if status != "failed" and key in self._objects:
                if pair not in self._of_lost:
                    duplicates.append(index)
                continue
            if status == "duplicate":
                # The take's row was deleted meanwhile: the next ingest imports this source.
                self._pairs.discard(pair)
                continue
            if status == "take":
                self._objects[key] = name
            kept.append(index)
        found = [batch if len(kept) == batch.num_rows else batch.take(kept)] if kept else []
        if duplicates:
            described = [self._duplicate(row) for row in batch.take(duplicates).to_pylist()]
            found.append(pa.RecordBatch.from_pylist(described, SCHEMA))
        return found

    def renewed(self, table: DeltaTable | None, batches: list[pa.RecordBatch]) -> list[pa.RecordBatch]:
        """Reads a table that another process has changed. Of rows that were new and are not in it, those that still are."""
        rows = _read_or_empty(table, ["status", "key", "source", "object"])
        found = list(zip(*(rows.column(name).to_pylist() for name in rows.column_names)))
        moved = {row["object"]: row["new"] for row in self.moved}
        takes = {key: name for status, key, _, name in found if status == "take" and key not in self._lost}
        self._objects = {key: moved.get(name, name) for key, name in takes.items()}
        self._pairs = {(key, source) for status, key, source, _ in found if status == "failed" or key in takes}
        # A lost take that another ingest repairs, too, may have further sources since.
        self._of_lost.update((key, source) for _, key, source, _ in found if key in self._lost)
        # Last: if the table cannot be read, the repeated commit reads it again.
        self.version = _version(table)
        return [new for batch in batches for new in self.new(batch)]

    def _duplicate(self, row: dict[str, Any]) -> dict[str, Any]:
        described = {**dict.fromkeys(row), **{name: row[name] for name in _OF_DUPLICATES}, "status": "duplicate"}
        return described | {"object": self._objects[row["key"]]}


_OF_DUPLICATES = (
    "key",
    "object",
    "source",
    "source_sha256",
    "source_bytes",
    "format",
    "subject",
    "session",
    "settings",
    "importer",
    "software",
    "ingested",
)


def pair_digest(key: str | None, source: str) -> bytes:
    """The hash of a key and the name of a source, of which a part is enough."""
    return source_hash(f"{key} {source}".encode())[:32].encode()

