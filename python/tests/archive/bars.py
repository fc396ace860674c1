"""Measures archives: ingest on workers, a filter of a large catalogue, windows beside other formats.

    python python/tests/archive/bars.py ingest --files 20000 --workers 0 1 2
    python python/tests/archive/bars.py catalogue --rows 1000000
    python python/tests/archive/bars.py windows --takes 1000

Each prints the load of the machine. Files are generated, at most 40 kB, and stay in --folder for the next run. With
AWS_ENDPOINT_URL and --bucket s3://..., the store is measured; CONTRIBUTING.md says how times are compared.
"""

import argparse
import io
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
from made import RATE_HZ, c3d, motion
from pyarrow import parquet

import mocapd
from mocapd import archive


def load():
    return " ".join(f"{load:.1f}" for load in os.getloadavg())


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

    @ray.remote(num_cpus=1)
    def warm():
        time.sleep(0.5)
        return archive.IMPORTER_VERSION

    found = sources(args.folder, args.files)
    for round_number in range(args.rounds):
        for workers in args.workers:
            bucket = f"{args.bucket or args.folder / 'archives'}/{time.time_ns()}"
            if workers:
                # The start of Ray is not measured: it is 5 s, once for any number of files.
                ray.init(num_cpus=workers, include_dashboard=False, log_to_driver=False)
                ray.get([warm.remote() for _ in range(workers)])
            report = archive.ingest(found, bucket, workers=workers, effort=1, progress=False)
            print(f"workers {workers}, round {round_number}: {report}; load {load()}", flush=True)
            if workers:
                ray.shutdown()


def catalogue(args):
    """Rows with labels, rates and durations at random, and the marker motion of imported files."""
    bucket = args.folder / f"catalogue-{args.rows}"
    if not bucket.exists():
        small = args.folder / "small"
        archive.ingest(sources(args.folder, 500), small, workers=0, effort=1, progress=False)
        base = archive.catalogue(small).arrow().to_pylist()
        random = np.random.default_rng(1)
        labels = [f"L{number:02}" for number in range(60)]
        table = archive.catalogue(bucket)
        for first in range(0, args.rows, 5000):
            rows = []
            for number in range(first, min(first + 5000, args.rows)):
                key = random.bytes(32).hex()
                changed = {
                    "key": key,
                    "object": archive.object_name(key),
                    "source": f"file:///data/s{number % 100}/{number}.c3d",
                    "source_sha256": random.bytes(32).hex(),
                    "labels": list(random.choice(labels, 20, replace=False)),
                    "rate_hz": float(random.choice([60, 100, 120, 240])),
                    "seconds": float(random.uniform(1, 300)),
                }
                rows.append(base[number % len(base)] | changed)
            table.append([pa.RecordBatch.from_pylist(rows, archive.SCHEMA)])
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
    """Windows of a second of two of 20 markers, from takes of a minute, beside Parquet and npz of the same samples."""
    bucket = args.bucket or str(args.folder / "windows")
    store = archive.open_store(bucket)
    labels = [f"m{number}" for number in range(20)]
    if store.size("npz/0.npz") is None:
        made = args.folder / "takes"
        made.mkdir(parents=True, exist_ok=True)
        for number in range(args.takes):
            points = motion(number, frames=6000, markers=20)
            if not (made / f"{number}.take").exists():
                mocapd.write_take(made / f"{number}.take", points, labels, RATE_HZ, 0.5, "fast")
            store.put_if_absent(f"parquet/{number}.parquet", as_parquet(points, labels))
            store.put_if_absent(f"npz/{number}.npz", as_npz(points, labels))
        archive.ingest(made, bucket, workers=0, progress=False)
    random = np.random.default_rng(2)
    picks = [(int(random.integers(args.takes)), int(random.integers(5900))) for _ in range(args.windows)]
    takes = archive.catalogue(bucket).sql("select object from takes order by source").column("object").to_pylist()
    form = archive.Form(store, 100, RATE_HZ, ("m3", "m7"))

    def from_take(number, first):
        return form.read(takes[number], first / RATE_HZ)

    def from_parquet(number, first):
        data = store.get(f"parquet/{number}.parquet")
        return parquet.read_table(io.BytesIO(data), columns=[f"m{at}_{axis}" for at in (3, 7) for axis in "xyz"])[
            first : first + 100
        ].to_pandas()

    def from_npz(number, first):
        data = np.load(io.BytesIO(store.get(f"npz/{number}.npz")))
        return data["m3"][first : first + 100], data["m7"][first : first + 100]

    for name, read in (("takes", from_take), ("parquet", from_parquet), ("npz", from_npz)):
        folder = {"takes": "takes/"}.get(name, f"{name}/")
        stored = sum(entry.n_bytes for entry in store.list(folder))
        before = store.traffic() if hasattr(store, "traffic") else (0, 0, 0)
        cpus, began = [], time.perf_counter()
        for number, first in picks:
            form._takes.clear()
            cpu = time.process_time()
            read(number, first)
            cpus.append(time.process_time() - cpu)
        seconds = time.perf_counter() - began
        traffic = store.traffic() if hasattr(store, "traffic") else (0, 0, 0)
        n_requests, n_bytes = ((after - was) / len(picks) for after, was in zip(traffic[:2], before))
        print(
            f"{name}: {len(picks) / seconds:.0f} windows a second, p50 {1000 * np.median(cpus):.2f} ms of processor time, "
            f"{n_requests:.2f} requests and {n_bytes / 1000:.1f} kB a window, {stored / 1e6:.1f} MB stored; load {load()}"
        )


def as_parquet(points, labels):
    columns = {f"{label}_{axis}": points[:, at, i] for at, label in enumerate(labels) for i, axis in enumerate("xyz")}
    out = io.BytesIO()
    parquet.write_table(pa.table(columns), out, compression="zstd", row_group_size=1000)
    return out.getvalue()


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
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--takes", type=int, default=1000)
    parser.add_argument("--windows", type=int, default=500)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    {"ingest": ingest, "catalogue": catalogue, "windows": windows}[args.what](args)


if __name__ == "__main__":
    main()
