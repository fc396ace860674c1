"""Windows of an archive for Dask: a data frame with a row for each window.

>>> from mocapd.archive.dask import data_frame
>>> frame = data_frame(windows(takes, seconds=1, hz=50, markers=["LKNE"], bucket="archive/"))
>>> frame["positions"].map(len).sum().compute()
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ._windows import TABLE, Windows


@dataclass(frozen=True)
class _Reader:
    windows: Windows

    def __call__(self, part: npt.NDArray[np.int64]) -> Any:
        import pandas

        table = pa.Table.from_batches(self.windows.rows(part), TABLE)
        return table.to_pandas(types_mapper=pandas.ArrowDtype)


def data_frame(windows: Windows, n_batches: int = 16) -> Any:
    """A ``dask.dataframe.DataFrame`` of this epoch's windows, with a partition for so many batches: ``object``,
    ``start_s``, ``positions`` (samples x markers x 3 values) and ``valid`` (samples x markers).
    """
    import dask.dataframe

    read = _Reader(windows)
    parts = windows.parts(n_batches) or [np.empty(0, dtype=np.int64)]
    return dask.dataframe.from_map(read, parts, meta=read(parts[0][:0]), label="mocapd-windows")
