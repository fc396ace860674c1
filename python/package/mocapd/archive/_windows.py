"""Windows of motion for training: a second or so of some markers, at one rate, from takes anywhere in the archive."""

from __future__ import annotations

import hashlib
import os
import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from ._catalogue import Catalogue, bucket_of
from ._keys import object_key
from ._store import Store, WindowTake, open_store
from ._workers import call

OPEN_TAKES = 64
"""Takes that a reader keeps open: a few hundred kilobytes each, for their indices and decoded samples, or more where windows
are long."""

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
        For lengths, rates or shards that are out of range, and a marker that none of the takes has, where the query selects
        their labels.
    """
    store = open_store(bucket_of(bucket))
    rows = Catalogue(store).sql(query) if isinstance(query, str) else query
    missing = {"object", "rate_hz", "frames"} - set(rows.column_names)
    if missing:
        raise ValueError(f"the query selects no {', '.join(sorted(missing))}: add it, or select *")
    if not (seconds > 0 and hz > 0 and (stride_s is None or stride_s > 0)) or round(seconds * hz) < 1:
        raise ValueError(f"windows of {seconds} s at {hz} Hz: expected times above 0, and a sample or more")
    if batch < 1:
        raise ValueError(f"batch={batch}: expected a window or more")
    if "labels" in rows.column_names and rows.num_rows:
        labels = set(pc.unique(pc.list_flatten(rows.column("labels"))).to_pylist())
        if absent := [marker for marker in markers if marker not in labels]:
            some = ", ".join(sorted(labels)[:20])
            raise ValueError(f"no take has a marker {', '.join(absent)}: their markers are {some}{', ...' * (len(labels) > 20)}")
    form = Form(store, round(seconds * hz), hz, tuple(markers))
    places = form.places(rows, seconds if stride_s is None else stride_s)
    return Windows(form, places, batch, shuffle, _checked(shard))


def _checked(shard: tuple[int, int]) -> tuple[int, int]:
    if not 0 <= shard[0] < shard[1]:
        raise ValueError(f"shard {shard}: expected the number of one of the readers, from 0, and how many they are")
    return shard


@dataclass(frozen=True)
class Places:
    """Where windows begin: a million takes are 8 MB, however many windows they have."""

    objects: tuple[str, ...]
    first: npt.NDArray[np.int64]
    """The number of the first window of each take, and of all."""
    stride_s: float
    digest: str
    """Of all on which the numbers of windows depend."""

    def __len__(self) -> int:
        return int(self.first[-1])

    def of(self, windows: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """The takes, by number, and the starts in seconds of windows."""
        takes = np.searchsorted(self.first, windows, side="right").astype(np.int64) - 1
        return takes, (windows - self.first[takes]).astype(np.float64) * self.stride_s


class Form:
    """What a window is, and how it is read. Keeps takes open, and can be sent to other processes, which open their own.
    Several threads may read."""

    def __init__(self, store: Store, samples: int, hz: float, markers: tuple[str, ...]) -> None:
        self.store, self.samples, self.hz, self.markers = store, samples, hz, markers
        self.__setstate__({})

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("store", "samples", "hz", "markers")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._takes: OrderedDict[str, WindowTake] = OrderedDict()
        self._opened_by = os.getpid()
        self._lock = threading.Lock()

    def places(self, rows: pa.Table, stride_s: float) -> Places:
        """All windows that lie within the takes of these rows. Their order is that of the objects, because that of the rows
        of a query is another one each time: readers and checkpoints have the same."""
        rows = pa.table({name: rows.column(name) for name in ("object", "rate_hz", "frames")}).drop_null()
        rows = rows.group_by(["object", "rate_hz", "frames"]).aggregate([]).sort_by("object")
        objects = np.array(rows.column("object").to_pylist(), dtype=str)
        if len(repeated := objects[1:][objects[1:] == objects[:-1]]):
            raise ValueError(f"rows of {repeated[0]} differ in rate_hz or frames: select each take once")
        columns = (rows.column(name).to_numpy(zero_copy_only=False) for name in ("rate_hz", "frames"))
        rate_hz, frames = (column.astype(np.float64) for column in columns)
        # From the first sample to the last one; a nanosecond absorbs the rounding of the division.
        last_start_s = (frames - 1) / rate_hz - (self.samples - 1) / self.hz + 1e-9
        counts = np.where(last_start_s >= 0, np.floor(last_start_s / stride_s + 1e-9) + 1, 0).astype(np.int64)
        keys = "".join(object_key(name) or name for name in objects.tolist())
        described = repr((self.samples, self.hz, self.markers, stride_s, np.version.short_version, keys)).encode()
        digest = hashlib.sha256(described + counts.tobytes()).hexdigest()[:16]
        return Places(tuple(objects.tolist()), np.concatenate([[0], np.cumsum(counts)]), stride_s, digest)

    def read(self, name: str, start_s: float) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Positions, float32 [samples, markers, 3] in millimetres, 0 where missing, and which samples are there."""
        take = self._open(name)
        at = (start_s + np.arange(self.samples) / self.hz) * take.rate_hz
        # A sample on a frame, but for rounding, is that frame's.
        at = np.where(np.abs(at - np.rint(at)) < 1e-6, np.rint(at), at)
        first, stop = int(at[0]), int(np.ceil(at[-1])) + 1
        if stop > take.n_frames:
            raise ValueError(f"{name} has {take.n_frames} frames, and no window at {start_s} s: its row states more")
        columns = {label: column for column, label in reversed(list(enumerate(take.labels)))}
        found = [marker for marker, label in enumerate(self.markers) if label in columns]
        out = np.full((self.samples, len(self.markers), 3), np.nan, dtype=np.float32)
        if found:
            wanted = [columns[self.markers[marker]] for marker in found]
            frames = call(lambda columns: take.window(first, stop, columns), wanted)
            out[:, found] = _interpolate(frames, at - first)
        valid: npt.NDArray[np.bool_] = np.asarray(np.isfinite(out).all(axis=2))
        out[~valid] = 0
        return out, valid

    def _open(self, name: str) -> WindowTake:
        if self._opened_by != os.getpid():
            # Of the process that this one was forked off from.
            self.__setstate__({})
        with self._lock:
            take = self._takes.pop(name, None)
        take = take or call(self.store.open_take, name)
        with self._lock:
            self._takes[name] = take
            if len(self._takes) > OPEN_TAKES:
                # Closed when the last thread has read it.
                self._takes.popitem(last=False)
        return take

    def batch(self, places: Places, indices: npt.NDArray[np.int64]) -> Batch:
        """The windows with these indices."""
        # Windows of the same take one after another, so that it is opened once.
        positions = np.empty((len(indices), self.samples, len(self.markers), 3), dtype=np.float32)
        valid = np.empty(positions.shape[:3], dtype=bool)
        takes, starts_s = places.of(indices)
        for row in np.argsort(takes, kind="stable"):
            positions[row], valid[row] = self.read(places.objects[takes[row]], float(starts_s[row]))
        return {
            "positions": positions,
            "valid": valid,
            "time_s": starts_s[:, None] + np.arange(self.samples) / self.hz,
            "object": np.array([places.objects[take] for take in takes], dtype=str),
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

    @property
    def n_windows(self) -> int:
        """Windows of this reader in an epoch; those of two readers differ by at most one."""
        rank, count = self.shard
        return max(0, -(-(len(self.places) - rank) // count))

    def __len__(self) -> int:
        """Batches that are left in this epoch."""
        return -(-max(self.n_windows - self.done, 0) // self.batch)

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
        return replace(self, done=done) if done < self.n_windows else self.next_epoch()

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
        """One of several parts, for the readers of a cluster. Divide first, and resume then: a position is that of a part."""
        if self.done:
            raise ValueError("windows that were resumed cannot be divided: call sharded() before resume()")
        return replace(self, shard=_checked((rank, count)), done=0)

    def state(self) -> dict[str, Any]:
        """Where this begins, for a checkpoint: ``windows.after(n).state()`` is the state after ``n`` batches."""
        return {"epoch": self.epoch, "done": self.done, "windows": self._digest()}

    def resume(self, state: dict[str, Any]) -> Windows:
        """Continues at a state of the same windows.

        Raises
        ------
        ValueError
            If the state is of other takes, markers, lengths, batches, seeds or shards, or of another version of NumPy.
        """
        if state["windows"] != self._digest():
            raise ValueError(
                "the state is of other windows: open the catalogue with the same version, and give the same query, markers, "
                "lengths, batch, seed and shard"
            )
        return replace(self, epoch=state["epoch"], done=state["done"])

    def _digest(self) -> str:
        described = repr((self.places.digest, self.batch, self.shuffle, self.shard))
        return hashlib.sha256(described.encode()).hexdigest()[:16]

    def ray_dataset(self, objects: bool = False) -> Any:
        """A ``ray.data.Dataset`` that reads this epoch's windows on the workers, some batches in a task: its
        ``iter_torch_batches`` yields tensors. ``objects`` adds the names of takes, of which there are no tensors."""
        import ray.data

        form, places = self.form, self.places

        def read(indices: Any) -> Any:
            batch = form.batch(places, indices["window"])
            return batch if objects else {name: value for name, value in batch.items() if name != "object"}

        indices = [pa.table({"window": part}) for part in self.parts()] or [pa.table({"window": np.empty(0, np.int64)})]
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
