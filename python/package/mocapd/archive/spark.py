"""Windows of an archive for Spark: a data source with a row for each window.

>>> spark.dataSource.register(mocapd.archive.spark.WindowsSource)
>>> options = {"bucket": "archive/", "query": "select * from takes", "seconds": 1, "hz": 50, "markers": "LKNE,RKNE"}
>>> spark.read.format("mocapd.windows").options(**options).load()
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pyarrow as pa
from pyspark.sql.datasource import DataSource, DataSourceReader, InputPartition

from ._windows import windows


class WindowsSource(DataSource):
    """Windows of the takes that ``query`` selects in ``bucket``: ``seconds``, ``hz``, ``markers`` (labels with commas),
    and ``stride_s``, ``shuffle`` and ``batch`` as for :func:`mocapd.archive.windows`.
    """

    @classmethod
    def name(cls) -> str:
        return "mocapd.windows"

    def schema(self) -> str:
        return "object string, start_s double, positions array<float>, valid array<boolean>"

    def reader(self, schema: Any) -> DataSourceReader:
        return WindowsReader(self.options)


class WindowsReader(DataSourceReader):
    """Reads parts of some batches on the executors."""

    def __init__(self, options: Any) -> None:
        given = {name: kind(options[name]) for name, kind in _OPTIONS.items() if name in options}
        markers = [label.strip() for label in options.get("markers", "").split(",") if label.strip()]
        self._windows = windows(options.get("query", "select * from takes"), markers=markers, **given)

    def partitions(self) -> list[InputPartition]:
        return [InputPartition(part) for part in self._windows.parts()]

    def read(self, partition: InputPartition) -> Iterator[pa.RecordBatch]:
        yield from self._windows.rows(partition.value)


_OPTIONS = {"bucket": str, "seconds": float, "hz": float, "stride_s": float, "shuffle": int, "batch": int}
