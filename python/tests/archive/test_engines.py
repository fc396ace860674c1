"""Windows and the catalogue in other engines."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

archive = pytest.importorskip("mocapd.archive")

import mocapd.archive as package  # noqa: E402
from made import RATE_HZ, write_c3ds  # noqa: E402

# Those of the engines.
pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture(scope="module")
def bucket(tmp_path_factory):
    folder = tmp_path_factory.mktemp("engines")
    write_c3ds(folder / "c3d", 5)
    archive.ingest(folder / "c3d", folder / "archive", workers=0, progress=False)
    return folder / "archive"


def windows(bucket):
    return archive.windows("select * from takes", 0.25, RATE_HZ, ["M0", "M1"], bucket=bucket, shuffle=2, batch=3)


def expected(bucket):
    """The positions and validity of each window, by its take and start."""
    found = {}
    for batch in windows(bucket):
        for name, time_s, positions, valid in zip(*(batch[key] for key in ("object", "time_s", "positions", "valid"))):
            found[str(name), float(time_s[0])] = positions.ravel(), valid.ravel()
    return found


def check(rows, bucket):
    """Compares rows of an object, a start, positions and validity."""
    found = {(name, start_s): (np.array(positions), np.array(valid)) for name, start_s, positions, valid in rows}
    wanted = expected(bucket)
    assert found.keys() == wanted.keys() and len(found) == 20
    for key, (positions, valid) in wanted.items():
        assert np.array_equal(found[key][0], positions) and np.array_equal(found[key][1], valid)


def test_dask_reads_windows(bucket):
    pytest.importorskip("dask.dataframe")
    from mocapd.archive.dask import data_frame

    frame = data_frame(windows(bucket), n_batches=2)
    assert frame.npartitions == 4
    table = frame.compute(scheduler="threads")
    check(zip(*(table[name] for name in ("object", "start_s", "positions", "valid"))), bucket)


def test_spark_reads_windows(bucket, monkeypatch):
    sql = pytest.importorskip("pyspark.sql")
    if not shutil.which("java"):
        pytest.skip("Spark needs Java")
    from mocapd.archive.spark import WindowsSource

    monkeypatch.setenv("PYSPARK_PYTHON", sys.executable)
    spark = sql.SparkSession.builder.master("local[1]").config("spark.ui.enabled", False).getOrCreate()
    try:
        spark.dataSource.register(WindowsSource)
        options = {"bucket": str(bucket), "seconds": 0.25, "hz": RATE_HZ, "markers": "M0,M1", "shuffle": 2, "batch": 3}
        rows = spark.read.format("mocapd.windows").options(**options).load().collect()
        check(rows, bucket)
    finally:
        spark.stop()


def test_readers_of_other_engines_are_short():
    for name in ("dask.py", "spark.py"):
        assert len((Path(package.__file__).parent / name).read_text().splitlines()) < 60


def test_other_engines_read_the_catalogue(bucket):
    table = str(bucket / "catalogue")
    polars = pytest.importorskip("polars")
    assert polars.read_delta(table)["frames"].to_list() == [120] * 5
    duckdb = pytest.importorskip("duckdb")
    dataset = archive.catalogue(bucket).delta().to_pyarrow_dataset()
    found = duckdb.sql("select sum(frames), max(len(labels)) from dataset where status = 'take'").fetchall()
    assert found == [(600, 4)] and dataset is not None
    assert archive.catalogue(bucket).arrow().to_pandas()["markers"].tolist() == [4] * 5
