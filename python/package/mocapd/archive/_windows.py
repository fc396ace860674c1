"""Windows of motion for training: a second or so of some markers, at one rate, from takes anywhere in the archive."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ._catalogue import Catalogue, bucket_of
from ._store import Store, WindowTake, open_store

OPEN_TAKES = 64
"""Takes that a reader keeps open: a few hundred kilobytes each, for their indices and decoded samples."""

Batch = dict[str, Any]
"""Arrays by name, all with one row for each window."""


def windows(
    query: str | pa.Table,
    seconds: float,
    hz: float,
    markers: Sequence[str],
    *,
    bucket: Any = None,
    stride_s: float | None = None,
    batch: int = 32,
    shuffle: int | None = None,
    shard: tuple[int, int] = (0, 1),
) -> Windows:
    """The windows of all takes that a query selects.

    Parameters
    ----------
    query
        SQL on the catalogue, such as ``"select * from takes where rate_hz >= 100"``, or a result of it. It must select
        ``object``, ``rate_hz`` and ``frames``.
    seconds, hz
        Length and rate of the windows. Samples between two frames are interpolated linearly; where one of the two is
        missing, so is the sample.
    markers
        Labels, in the order of the axis. A marker that a take does not have is missing in its windows.
    bucket
        The archive; by default the one that ``MOCAPD_ARCHIVE`` names.
    stride_s
        Time from the start of one window to the next in a take; by default the length.
    batch
        Windows of a batch; the last one may have fewer.
    shuffle
        A seed: the windows then come in an order at random, another one in each epoch. None for the order of takes.
    shard
        This reader's number, and the number of readers among which the windows are divided.

    Raises
    ------
    ValueError
        For lengths, rates or shards that are out of range.
    """
    store = open_store(bucket_of(bucket))
    rows = Catalogue(store).sql(query) if isinstance(query, str) else query
    missing = {"object", "rate_hz", "frames"} - set(rows.column_names)
    if missing:
        raise ValueError(f"the query selects no {', '.join(sorted(missing))}: add it, or select *")
    if not (seconds > 0 and hz > 0 and (stride_s is None or stride_s > 0)) or round(seconds * hz) < 1:
        raise ValueError(f"windows of {seconds} s at {hz} Hz: expected times above 0, and a sample or more")
    if not (batch >= 1 and 0 <= shard[0] < shard[1]):
        raise ValueError(f"batch={batch}, shard={shard}: expected a window or more, and the number of one of the readers")
    form = Form(store, round(seconds * hz), hz, tuple(markers))
    places = form.places(rows, seconds if stride_s is None else stride_s)
    return Windows(form, places, batch, shuffle, shard)


@dataclass(frozen=True)
class Places:
    """Where windows begin: for each its take, by index, and its start in seconds."""

    objects: tuple[str, ...]
    take: npt.NDArray[np.int64]
    start_s: npt.NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.take)


class Form:
    """What a window is, and how it is read. Keeps takes open, and can be sent to other processes, which open their own."""

    def __init__(self, store: Store, samples: int, hz: float, markers: tuple[str, ...]) -> None:
        self.store, self.samples, self.hz, self.markers = store, samples, hz, markers
        self._takes: OrderedDict[str, WindowTake] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_takes": OrderedDict()}

    def places(self, rows: pa.Table, stride_s: float) -> Places:
        """All windows that lie within the takes of these rows."""
        objects = tuple(rows.column("object").to_pylist())
        columns = (rows.column(name).to_numpy(zero_copy_only=False) for name in ("rate_hz", "frames"))
        rate_hz, frames = (column.astype(np.float64) for column in columns)
        # From the first sample to the last one; a nanosecond absorbs the rounding of the division.
        last_start_s = (frames - 1) / rate_hz - (self.samples - 1) / self.hz + 1e-9
        counts = np.where(last_start_s >= 0, np.floor(last_start_s / stride_s + 1e-9) + 1, 0).astype(np.int64)
        take = np.repeat(np.arange(len(objects)), counts)
        number = np.arange(len(take)) - np.repeat(np.cumsum(counts) - counts, counts)
        return Places(objects, take, number.astype(np.float64) * stride_s)

    def read(self, name: str, start_s: float) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Positions, float32 [samples, markers, 3] in millimetres, 0 where missing, and which samples are there."""
        take = self._open(name)
        at = (start_s + np.arange(self.samples) / self.hz) * take.rate_hz
        # A sample on a frame, but for rounding, is that frame's.
        at = np.where(np.abs(at - np.rint(at)) < 1e-6, np.rint(at), at)
        first, stop = int(at[0]), min(int(np.ceil(at[-1])) + 1, take.n_frames)
        columns = {label: column for column, label in reversed(list(enumerate(take.labels)))}
        found = [marker for marker, label in enumerate(self.markers) if label in columns]
        out = np.full((self.samples, len(self.markers), 3), np.nan, dtype=np.float32)
        if found:
            wanted = [columns[self.markers[marker]] for marker in found]
            frames = take.window(first, stop, wanted)
            out[:, found] = _interpolate(frames, at - first)
        valid: npt.NDArray[np.bool_] = np.asarray(np.isfinite(out).all(axis=2))
        out[~valid] = 0
        return out, valid

    def _open(self, name: str) -> WindowTake:
        take = self._takes.pop(name, None) or self.store.open_take(name)
        self._takes[name] = take
        if len(self._takes) > OPEN_TAKES:
            self._takes.popitem(last=False)[1].close()
        return take

    def batch(self, places: Places, indices: npt.NDArray[np.int64]) -> Batch:
        """The windows with these indices."""
        # Windows of the same take one after another, so that it is opened once.
        positions = np.empty((len(indices), self.samples, len(self.markers), 3), dtype=np.float32)
        valid = np.empty(positions.shape[:3], dtype=bool)
        for row in np.argsort(places.take[indices], kind="stable"):
            index = indices[row]
            name, start_s = places.objects[places.take[index]], float(places.start_s[index])
            positions[row], valid[row] = self.read(name, start_s)
        starts_s = places.start_s[indices]
        return {
            "positions": positions,
            "valid": valid,
            "time_s": starts_s[:, None] + np.arange(self.samples) / self.hz,
            "object": np.array([places.objects[take] for take in places.take[indices]], dtype=str),
        }


def _interpolate(frames: npt.NDArray[np.float32], at: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Samples at fractions of frames. One on a frame needs only that frame."""
    below = np.minimum(np.floor(at).astype(np.int64), len(frames) - 1)
    share = (at - below).astype(np.float32)[:, None, None]
    low = frames[below]
    high = frames[np.minimum(below + 1, len(frames) - 1)]
    return np.where(share == 0, low, low + share * (high - low))


@dataclass(frozen=True)
class Windows:
    """Windows, in batches. Each iteration is an epoch; :meth:`state` and :meth:`resume` continue within one."""

    form: Form
    places: Places
    batch: int
    shuffle: int | None
    shard: tuple[int, int]
    epoch: int = 0
    done: int = 0
    """Windows of the shard, in this epoch, that were read before."""

    def order(self) -> npt.NDArray[np.int64]:
        """The windows of this shard in this epoch. All shards have the same order of all windows, and divide it."""
        order = np.arange(len(self.places))
        if self.shuffle is not None:
            order = np.random.default_rng([self.shuffle, self.epoch]).permutation(order)
        rank, count = self.shard
        return order[rank::count]

    def __len__(self) -> int:
        """Batches that are left in this epoch."""
        return -(-max(len(self.order()) - self.done, 0) // self.batch)

    def __iter__(self) -> Iterator[Batch]:
        """Batches of NumPy arrays: ``positions`` [windows, samples, markers, 3], ``valid`` [windows, samples, markers],
        ``time_s`` [windows, samples] from the first frame of the take, and ``object``."""
        order = self.order()[self.done :]
        for first in range(0, len(order), self.batch):
            yield self.form.batch(self.places, order[first : first + self.batch])

    def torch(self) -> Iterator[Batch]:
        """Batches of torch tensors; ``object`` stays an array of texts."""
        import torch

        for batch in self:
            yield {name: value if name == "object" else torch.from_numpy(value) for name, value in batch.items()}

    def arrow(self) -> Iterator[pa.RecordBatch]:
        """Arrow batches with columns of tensors."""
        for batch in self:
            yield to_arrow(batch)

    def after(self, n_batches: int) -> Windows:
        """The windows that follow after so many batches of this epoch, to resume from a checkpoint of the trainer: the
        next epoch's if these were all."""
        done = self.done + n_batches * self.batch
        return replace(self, done=done) if done < len(self.order()) else self.next_epoch()

    def parts(self, n_batches: int = 16) -> list[npt.NDArray[np.int64]]:
        """The windows that are left in this epoch, in parts of so many batches: the tasks of another engine."""
        order, size = self.order()[self.done :], n_batches * self.batch
        return [order[first : first + size] for first in range(0, len(order), size)]

    def rows(self, part: npt.NDArray[np.int64]) -> Iterator[pa.RecordBatch]:
        """Reads a part, as rows of :data:`TABLE`."""
        for first in range(0, len(part), self.batch):
            yield to_rows(self.form.batch(self.places, part[first : first + self.batch]))

    def next_epoch(self) -> Windows:
        return replace(self, epoch=self.epoch + 1, done=0)

    def sharded(self, rank: int, count: int) -> Windows:
        """One of several parts, for the readers of a cluster."""
        return replace(self, shard=(rank, count), done=0)

    def state(self) -> dict[str, int]:
        """Where this is in its sequence, for a checkpoint."""
        return {"epoch": self.epoch, "done": self.done}

    def resume(self, state: dict[str, int]) -> Windows:
        """Continues at a state of the same windows."""
        return replace(self, epoch=state["epoch"], done=state["done"])

    def ray_dataset(self) -> Any:
        """A ``ray.data.Dataset`` that reads this epoch's windows on the workers: its ``iter_torch_batches`` yields
        tensors."""
        import ray.data

        form, places, order = self.form, self.places, self.order()[self.done :]

        def read(indices: dict[str, npt.NDArray[np.int64]]) -> Batch:
            return form.batch(places, indices["window"])

        indices = pa.table({"window": order})
        return ray.data.from_arrow(indices).map_batches(read, batch_size=self.batch)


def to_arrow(batch: Batch) -> pa.RecordBatch:
    """A batch as Arrow columns, of which those with more than one axis are tensors."""
    columns = {}
    for name, value in batch.items():
        if value.ndim == 1:
            columns[name] = pa.array(value)
        elif value.dtype == bool:
            # Arrow has no tensors of bits.
            columns[name] = pa.FixedShapeTensorArray.from_numpy_ndarray(value.astype(np.uint8))
        else:
            columns[name] = pa.FixedShapeTensorArray.from_numpy_ndarray(np.ascontiguousarray(value))
    return pa.RecordBatch.from_pydict(columns)


TABLE = pa.schema(
    [("object", pa.string()), ("start_s", pa.float64()), ("positions", pa.list_(pa.float32())), ("valid", pa.list_(pa.bool_()))]
)
"""Windows as rows, for engines without tensors: ``positions`` has samples x markers x 3 values, in this order."""


def to_rows(batch: Batch) -> pa.RecordBatch:
    """A batch as rows of :data:`TABLE`."""
    n_windows = len(batch["valid"])

    def lists(values: npt.NDArray[Any]) -> pa.ListArray:
        width = values[0].size if n_windows else 0
        return pa.ListArray.from_arrays(np.arange(n_windows + 1, dtype=np.int32) * width, values.ravel())

    columns = [batch["object"], batch["time_s"][:, 0], lists(batch["positions"]), lists(batch["valid"])]
    return pa.RecordBatch.from_arrays([pa.array(column) for column in columns], schema=TABLE)
