"""The catalogue of an archive: a Delta table with a row for each source that was ingested."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from deltalake import DeltaTable, QueryBuilder, write_deltalake
from deltalake.exceptions import DeltaError, TableNotFoundError

from ._keys import source_hash
from ._schema import SCHEMA
from ._store import Store, open_store

FOLDER = "catalogue"
"""The folder of the table in the bucket."""

BUCKET_VARIABLE = "MOCAPD_ARCHIVE"
"""The environment variable with the bucket of the archive, where none is given."""


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
    """The rows of an archive. One process at a time writes: the driver of an ingest."""

    def __init__(self, store: Store, version: int | None = None) -> None:
        self.store = store
        self.url = f"{store.url.rstrip('/')}/{FOLDER}"
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
        names = list(columns) if columns is not None else SCHEMA.names
        table = self.delta()
        if table is None:
            return pa.schema([SCHEMA.field(name) for name in names]).empty_table()
        return table.to_pyarrow_table(columns=names)

    def sql(self, query: str) -> pa.Table:
        """The result of a query by DataFusion. The table is ``catalogue``; ``takes`` has only its takes.

        Raises
        ------
        FileNotFoundError
            If there is no archive.
        ValueError
            For a query that is not valid.
        """
        context = QueryBuilder().register("catalogue", self.existing())
        context.execute("create view takes as select * from catalogue where status = 'take'")
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

    def append(self, batches: list[pa.RecordBatch]) -> None:
        """Commits rows. They are in the table, all of them, when this returns."""
        table = pa.Table.from_batches(batches, SCHEMA)
        write_deltalake(
            self.url, table, mode="append", name="catalogue of a mocapd archive", storage_options=self._options
        )

    def move(self, rows: list[dict[str, Any]]) -> None:
        """Commits new objects of takes: rows with ``object``, ``new`` and ``new_bytes``."""
        if not rows:
            return
        moved = pa.table({name: [row[name] for row in rows] for name in ("object", "new", "new_bytes")})
        merge = self.existing().merge(moved, "old.object = moved.object", source_alias="moved", target_alias="old")
        merge.when_matched_update({"object": "moved.new", "take_bytes": "moved.new_bytes"}).execute()

    def delete(self, where: str) -> int:
        """Removes the rows for which an SQL condition holds, such as ``importer < 2``; former versions of the table keep
        them. Their objects stay until :func:`collect` removes them. Returns the number of rows.
        """
        return int(self.existing().delete(where)["num_deleted_rows"])


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
    """The rows that exist, to which an ingest only adds."""

    def __init__(self, table: Catalogue) -> None:
        rows = table.arrow(["status", "key", "source"])
        columns = [rows.column(name).to_pylist() for name in ("status", "key", "source")]
        self._pairs = {(key, source) for _, key, source in zip(*columns)}
        self._takes = {key for status, key, _ in zip(*columns) if status == "take"}

    def digests(self) -> npt.NDArray[np.bytes_]:
        """What workers need to skip the files that have a row: sorted hashes of 16 bytes."""
        return np.sort(np.array([pair_digest(key, source) for key, source in self._pairs], dtype="S32"))

    def new(self, batch: pa.RecordBatch) -> pa.RecordBatch:
        """The rows of a batch that are new. A take that has the key of another one becomes a duplicate."""
        rows: list[dict[str, Any]] = []
        for row in batch.to_pylist():
            key, source = row["key"], row["source"]
            if (key, source) in self._pairs:
                continue
            self._pairs.add((key, source))
            if row["status"] == "take":
                if key in self._takes:
                    row = {**dict.fromkeys(row), **{name: row[name] for name in _OF_DUPLICATES}, "status": "duplicate"}
                self._takes.add(key)
            rows.append(row)
        return pa.RecordBatch.from_pylist(rows, SCHEMA)


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
    """The hash of a key and the name of a source."""
    return source_hash(f"{key} {source}".encode())[:32].encode()

