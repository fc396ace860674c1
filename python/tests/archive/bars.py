"""Measures archives: ingest on workers, a filter of a large catalogue, windows beside other formats.

    python python/tests/archive/bars.py ingest --files 20000 --workers 0 1 2
    python python/tests/archive/bars.py ingest --files 100000 --workers 2 --again
    python python/tests/archive/bars.py catalogue --rows 1000000
    python python/tests/archive/bars.py windows --takes 1000 --bucket s3://takes-test/bars

The last one needs the package zarr. Each prints the load of the machine. Files are generated, at most 40 kB, and stay
in --folder for the next run. With AWS_ENDPOINT_URL and --bucket s3://..., the store is measured, as moto.server;
CONTRIBUTING.md says how times are compared.
"""

import argparse
import contextlib
import io
import os
import resource
import shutil
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
from made import RATE_HZ, c3d, motion
from pyarrow import parquet

import mocapd
from mocapd import archive

ROWS = 5000
"""Of a commit of an ingest."""

TICK_S = 1 / os.sysconf("SC_CLK_TCK")


def load():
    return " ".join(f"{load:.1f}" for load in os.getloadavg())


def processor_times():
    """Seconds of processor time so far: of this process, of Ray's workers, of Ray's other processes, and of the machine, in
    which the kernel's threads for the disk are included."""
    found = {"driver": sum(os.times()[:2]), "workers": 0.0, "ray": 0.0}
    processes = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            command = (path.parent / "cmdline").read_bytes()
            processes[int(path.parent.name)] = int(fields[1]), (int(fields[11]) + int(fields[12])) * TICK_S, command
    for pid, (parent, seconds, command) in processes.items():
        while parent in processes and parent != os.getpid():
            parent = processes[parent][0]
        if parent == os.getpid() and pid != parent:
            is_worker = command.startswith(b"ray::") or b"default_worker.py" in command
            found["workers" if is_worker else "ray"] += seconds
    # User, nice, system, and the kernel's interrupts.
    busy = [int(Path("/proc/stat").read_text().split()[at]) for at in (1, 2, 3, 6, 7)]
    return found | {"machine": sum(busy) * TICK_S}


def sources(folder, n):
    """Files in folders of 500."""
    to = folder / f"c3d-{n}"
    if not to.exists():
        making = folder / f"c3d-{n}.part"
        shutil.rmtree(making, ignore_errors=True)
        for number in range(n):
            path = making / f"{number // 500:04}" / f"{number:07}.c3d"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(c3d(number, frames=120, markers=20))
        making.rename(to)
    return to


def ingest(args):
    import ray

    def warm(number, seconds=0.5):
        """Loads what a process loads once."""
        time.sleep(seconds)
        archive.ingest(few, args.folder / "warm" / f"{time.time_ns()}-{number}", workers=0, effort=1, progress=False)

    few, found = sources(args.folder, 8), sources(args.folder, args.files)
    warm(0, 0)
    for round_number in range(args.rounds):
        for workers in args.workers:
            bucket = f"{args.bucket or args.folder / 'archives'}/{time.time_ns()}"
            if workers:
                # The start of Ray is not measured: it is 5 s, once for any number of files.
                ray.init(num_cpus=workers, include_dashboard=False, log_to_driver=False)
                ray.get([ray.remote(num_cpus=1)(warm).remote(number) for number in range(workers)])
            for repeat in range(1 + args.again):
                before = processor_times()
                report = archive.ingest(found, bucket, workers=workers, effort=1, progress=False)
                spent = {name: 1000 * (after - before[name]) / report.files for name, after in processor_times().items()}
                times = ", ".join(f"{name} {ms:.2f}" for name, ms in spent.items())
                print(f"workers {workers}, round {round_number}{', again' * repeat}: {report}")
                print(f"    ms of a processor for each file: {times}; load {load()}", flush=True)
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            listed = [entry.n_bytes for entry in archive.open_store(bucket).list("catalogue/")]
            print(f"    at most {memory:.0f} MiB of memory in the driver; catalogue: {sum(listed) / 1e6:.1f} MB in {len(listed)} files")
            if workers:
                ray.shutdown()


def catalogue(args):
    """Rows with labels, rates and durations at random, and the marker motion of imported files."""
    bucket = args.folder / f"catalogue-{args.rows}"
    if not bucket.exists():
        small = args.folder / "small"
        archive.ingest(sources(args.folder, 500), small, workers=0, effort=1, progress=False)
        base = archive.catalogue(small).arrow()
        base = pa.concat_tables([base] * (ROWS // len(base))).combine_chunks()
        random = np.random.default_rng(1)
        labels = np.array([f"L{number:02}" for number in range(60)])
        table = archive.catalogue(bucket)
        for first in range(0, args.rows, ROWS):
            keys = [random.bytes(32).hex() for _ in range(ROWS)]
            picked = labels[np.argsort(random.random((ROWS, len(labels))))[:, :20]]
            changed = {
                "key": keys,
                "object": [archive.object_name(key) for key in keys],
                "source": [f"file:///data/s{number % 100}/{number}.c3d" for number in range(first, first + ROWS)],
                "source_sha256": [random.bytes(32).hex() for _ in range(ROWS)],
                "take_sha256": [random.bytes(32).hex() for _ in range(ROWS)],
                "labels": picked.tolist(),
                "rate_hz": random.choice([60.0, 100.0, 120.0, 240.0], ROWS),
                "seconds": random.uniform(1, 300, ROWS),
            }
            rows = base
            for name, values in changed.items():
                kind = archive.SCHEMA.field(name)
                rows = rows.set_column(archive.SCHEMA.names.index(name), kind, pa.array(values, kind.type))
            table.append(rows.to_batches(), "bars", first // ROWS + 1)
    query = "select key, object from takes where array_has(labels, 'L07') and rate_hz >= 200 and seconds between 100 and 110"
    os.sched_setaffinity(0, {0})
    table = archive.catalogue(bucket)
    for _ in range(5):
        began, cpu = time.perf_counter(), time.process_time()
        n = table.sql(query).num_rows
        print(f"{n} rows: {time.perf_counter() - began:.2f} s, {time.process_time() - cpu:.2f} s of one core; load {load()}")
    n_bytes = sum(path.stat().st_size for path in (bucket / "catalogue").glob("*.parquet"))
    print(f"{n_bytes / args.rows:.0f} bytes a row")


def windows(args):
    """Windows of a second of two of 20 markers, from takes of a minute, beside the same from Parquet, Zarr and npz.

    Each window is read as the first of its file, so the indices and footers of all formats are read for each. Of Parquet and
    Zarr only the needed parts are read, with a row group of ten seconds and a chunk of five.
    """
    store = archive.open_store(args.bucket)
    labels = [f"m{number}" for number in range(20)]
    if store.size("made") is None:
        made = args.folder / "takes"
        made.mkdir(parents=True, exist_ok=True)
        for number in range(args.takes):
            points = motion(number, frames=6000, markers=20)
            if not (made / f"{number:04}.take").exists():
                mocapd.write_take(made / f"{number:04}.take", points, labels, RATE_HZ, 0.5, "fast")
            if number >= args.peers:
                continue
            store.put_if_absent(f"parquet/{number}.parquet", as_parquet(points, labels))
            store.put_if_absent(f"npz/{number}.npz", as_npz(points, labels))
            for name, data in as_zarr(points).items():
                store.put_if_absent(f"zarr/{number}/{name}", data)
        archive.ingest(made, args.bucket, workers=0, progress=False)
        store.put_if_absent("made", b"all")
    random = np.random.default_rng(2)
    picks = [(int(random.integers(args.takes)), int(random.integers(5900))) for _ in range(args.windows)]
    takes = archive.catalogue(args.bucket).sql("select object from takes order by source").column("object").to_pylist()
    form = archive.Form(store, 100, RATE_HZ, ("m3", "m7"))

    def from_take(number, first):
        form._takes.clear()
        return form.read(takes[number], first / RATE_HZ)[0]

    def from_parquet(number, first):
        file = parquet.ParquetFile(pa.PythonFile(RangeFile(store, f"parquet/{number}.parquet"), mode="r"), pre_buffer=True)
        groups = sorted({first // 1000, (first + 99) // 1000})
        columns = [f"m{at}_{axis}" for at in (3, 7) for axis in "xyz"]
        found = file.read_row_groups(groups, columns=columns, use_threads=False).to_pandas().to_numpy()
        return found[first - 1000 * groups[0] :][:100].reshape(100, 2, 3)

    import zarr.storage
    from zarr.core.buffer import cpu as cpu_buffer

    def from_zarr(number, first):
        names = ["zarr.json", *(f"c/{chunk}/0/0" for chunk in sorted({first // 500, (first + 99) // 500}))]
        found = {name: cpu_buffer.Buffer.from_bytes(whole(store, f"zarr/{number}/{name}")) for name in names}
        return zarr.open_array(zarr.storage.MemoryStore(found), mode="r")[first : first + 100, [3, 7]]

    def from_npz(number, first):
        data = np.load(io.BytesIO(whole(store, f"npz/{number}.npz")))
        return np.stack([data[label][first : first + 100] for label in ("m3", "m7")], axis=1)

    readers = {"takes": from_take, "parquet": from_parquet, "zarr": from_zarr, "npz": from_npz}
    # The same windows, within the tolerance.
    for number, first in picks[:5]:
        number %= args.peers
        one = from_take(number, first)
        for name, read in readers.items():
            assert np.abs(np.nan_to_num(read(number, first)) - one).max() < 0.51, name
    for name, read in [("all takes", from_take), *readers.items()]:
        stored = sum(entry.n_bytes for entry in store.list(f"{name.split()[-1]}/"))
        before = store.traffic()
        cpus, requests, began = [], [], time.perf_counter()
        for number, first in picks if name == "all takes" else [(number % args.peers, first) for number, first in picks]:
            cpu, was = time.process_time(), store.traffic()[0]
            read(number, first)
            cpus.append(time.process_time() - cpu)
            requests.append(store.traffic()[0] - was)
        seconds = time.perf_counter() - began
        n_bytes = (store.traffic()[1] - before[1]) / len(picks)
        print(
            f"{name}: {len(picks) / seconds:.0f} windows a second, p50 {1000 * np.median(cpus):.2f} ms of processor time, "
            f"{np.mean(requests):.2f} requests (at most {max(requests)}) and {n_bytes / 1000:.1f} kB a window, "
            f"{stored / 1e6:.1f} MB stored; load {load()}",
            flush=True,
        )


def whole(store, name):
    """An object in one request."""
    return store._native.read(name, 0, 1 << 40)


class RangeFile(io.RawIOBase):
    """An object, of which ranges are read."""

    def __init__(self, store, name):
        self.store, self.name, self.at, self.n_bytes = store, name, 0, store.size(name)

    def readable(self):
        return True

    def seekable(self):
        return True

    def seek(self, offset, whence=0):
        self.at = offset + (0, self.at, self.n_bytes)[whence]
        return self.at

    def tell(self):
        return self.at

    def read(self, n=-1):
        stop = self.n_bytes if n < 0 else min(self.at + n, self.n_bytes)
        data = self.store._native.read(self.name, self.at, stop) if stop > self.at else b""
        self.at = stop
        return data


def as_parquet(points, labels):
    columns = {f"{label}_{axis}": points[:, at, i] for at, label in enumerate(labels) for i, axis in enumerate("xyz")}
    out = io.BytesIO()
    parquet.write_table(pa.table(columns), out, compression="zstd", row_group_size=1000)
    return out.getvalue()


def as_zarr(points):
    import zarr.storage

    store = zarr.storage.MemoryStore()
    array = zarr.create_array(store, shape=points.shape, chunks=(500, 20, 3), dtype="float32")
    array[:] = points
    return {name: value.to_bytes() for name, value in store._store_dict.items()}


def as_npz(points, labels):
    out = io.BytesIO()
    np.savez_compressed(out, **{label: points[:, at] for at, label in enumerate(labels)})
    return out.getvalue()


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=["ingest", "catalogue", "windows"])
    parser.add_argument("--folder", type=Path, default=Path("/tmp/mocapd-archive-bars"))
    parser.add_argument("--bucket")
    parser.add_argument("--files", type=int, default=2000)
    parser.add_argument("--workers", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--again", action="store_true", help="ingest twice: the second time, all files have a row")
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--takes", type=int, default=1000)
    parser.add_argument("--peers", type=int, default=200, help="takes that the other formats have, too")
    parser.add_argument("--windows", type=int, default=500)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    {"ingest": ingest, "catalogue": catalogue, "windows": windows}[args.what](args)


if __name__ == "__main__":
    main()
