"""Windows of motion: their samples, their order, and who reads which."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pyarrow as pa
import pytest

import mocapd

archive = pytest.importorskip("mocapd.archive")

from made import RATE_HZ, motion  # noqa: E402

LABELS = ["a", "b", "c", "d"]


@pytest.fixture(scope="module")
def bucket(tmp_path_factory):
    """Five takes of 1.2 to 5.2 s, one of them at another rate and with other markers."""
    folder = tmp_path_factory.mktemp("windows")
    for number in range(5):
        labels = LABELS if number < 4 else ["d", "a", "x", "y"]
        rate_hz = RATE_HZ if number < 4 else 60.0
        points = motion(number, frames=121 + 100 * number)
        mocapd.write_take(folder / f"{number}.take", points, labels, rate_hz, None, "lossless")
    archive.ingest(folder, folder / "archive", workers=0, progress=False)
    return folder / "archive"


def rows(bucket):
    return archive.catalogue(bucket).sql("select source, object, rate_hz, frames from takes order by source")


def test_windows_hold_the_samples_of_their_frames(bucket):
    found = archive.windows(rows(bucket), 1.0, RATE_HZ, ["c", "a", "nobody"], bucket=bucket, batch=4)
    batches = list(found)
    assert [len(batch["valid"]) for batch in batches] == [4, 4, 4, 4, 2]
    names = rows(bucket).column("object").to_pylist()
    for batch in batches:
        for positions, valid, time_s, name in zip(*(batch[key] for key in ("positions", "valid", "time_s", "object"))):
            number = names.index(name)
            assert not valid[:, 2].any() and (positions[:, 2] == 0).all()
            if number == 4:
                continue
            first = round(time_s[0] * RATE_HZ)
            points = motion(number, frames=121 + 100 * number)[first : first + 100][:, [2, 0]]
            assert np.array_equal(positions[:, :2], points) and valid[:, :2].all()


def test_rows_of_a_query_may_repeat_takes_or_have_none(bucket):
    """As rows of duplicates and of files that failed, which have no rate, in any order."""
    wanted = rows(bucket)
    (name,) = wanted.column("object").to_pylist()[:1]
    others = pa.table({"source": ["copy", "bad", "copy"], "object": [name, None, name], "rate_hz": [None, None, RATE_HZ], "frames": [None, None, 121]})
    others = others.cast(wanted.schema)
    expected = archive.windows(wanted, 1.0, RATE_HZ, ["a"], bucket=bucket)
    for table in (pa.concat_tables([others, wanted]), pa.concat_tables([wanted, others])):
        found = archive.windows(table, 1.0, RATE_HZ, ["a"], bucket=bucket)
        assert found.places.objects == expected.places.objects and found.n_windows == expected.n_windows
        assert found.state() == expected.state()
    differing = pa.table({"source": ["x"], "object": [name], "rate_hz": [50.0], "frames": [121]}).cast(wanted.schema)
    with pytest.raises(ValueError, match="differ in rate_hz or frames"):
        archive.windows(pa.concat_tables([wanted, differing]), 1.0, RATE_HZ, ["a"], bucket=bucket)


def test_a_gap_is_invalid(bucket):
    (batch,) = archive.windows(rows(bucket).slice(0, 1), 1.0, RATE_HZ, ["b"], bucket=bucket)
    expected = np.ones(100, bool)
    expected[20:30] = False
    assert np.array_equal(batch["valid"][0, :, 0], expected)
    # Between two frames both are needed: half the rate with a shift of half a frame.
    (batch,) = archive.windows(rows(bucket).slice(0, 1), 1.0, 200.0, ["b"], bucket=bucket)
    invalid = np.flatnonzero(~batch["valid"][0, :, 0])
    assert invalid.tolist() == list(range(39, 60))


def test_another_rate_is_interpolated(bucket):
    found = archive.windows(rows(bucket).slice(4, 1), 1.0, 90.0, ["d"], bucket=bucket, batch=100)
    (batch,) = found
    points = motion(4, frames=521)[:, 0].astype(float)
    for positions, time_s in zip(batch["positions"], batch["time_s"]):
        for axis in range(3):
            expected = np.interp(time_s, np.arange(521) / 60.0, points[:, axis])
            assert np.allclose(positions[:, 0, axis], expected, atol=1e-3)


def test_windows_lie_within_their_takes(bucket):
    table = rows(bucket)
    # 121 frames at 100 Hz are 1.2 s from the first frame to the last.
    for seconds, stride_s, expected in ((1.0, None, 1), (0.4, 0.4, 3), (1.21, None, 1), (1.22, None, 0), (1.0, 0.1, 3)):
        found = archive.windows(table.slice(0, 1), seconds, RATE_HZ, ["a"], bucket=bucket, stride_s=stride_s)
        assert len(found.places) == expected, seconds
        for batch in found:
            assert batch["time_s"].max() <= 1.2 + 1e-9


def order(windows):
    return [(name, start) for batch in windows for name, start in zip(batch["object"], batch["time_s"][:, 0])]


def test_shards_divide_the_windows_of_each_epoch(bucket):
    all_windows = archive.windows(rows(bucket), 0.5, 50.0, ["a"], bucket=bucket, shuffle=7, batch=3)
    whole = order(all_windows)
    assert len(set(whole)) == len(whole) > 20 and order(all_windows) == whole
    assert whole != order(archive.windows(rows(bucket), 0.5, 50.0, ["a"], bucket=bucket))
    parts = [order(all_windows.sharded(rank, 3)) for rank in range(3)]
    assert sorted(sum(parts, [])) == sorted(whole) and min(map(len, parts)) >= len(whole) // 3
    following = order(all_windows.next_epoch())
    assert following != whole and sorted(following) == sorted(whole)


def test_reading_resumes_where_it_was(bucket):
    windows = archive.windows(rows(bucket), 0.5, 50.0, ["a"], bucket=bucket, shuffle=7, batch=4)
    whole = order(windows)
    state = windows.after(2).state()
    again = archive.windows(rows(bucket), 0.5, 50.0, ["a"], bucket=bucket, shuffle=7, batch=4).resume(state)
    assert order(again) == whole[8:] and len(again) == len(windows) - 2
    state = windows.after(len(windows)).state()
    assert (state["epoch"], state["done"]) == (1, 0)
    for others in (
        archive.windows(rows(bucket), 0.5, 50.0, ["a"], bucket=bucket, shuffle=8, batch=4),
        archive.windows(rows(bucket), 0.5, 50.0, ["b"], bucket=bucket, shuffle=7, batch=4),
        archive.windows(rows(bucket).slice(1), 0.5, 50.0, ["a"], bucket=bucket, shuffle=7, batch=4),
        windows.sharded(0, 2),
    ):
        with pytest.raises(ValueError, match="other windows"):
            others.resume(state)
    with pytest.raises(ValueError, match="sharded"):
        again.sharded(0, 2)


def test_the_order_of_rows_changes_nothing(bucket):
    """That of a query is another one each time."""
    table = rows(bucket)
    mixed = table.take([3, 0, 4, 2, 1, 3])
    one, other = (archive.windows(found, 0.5, 50.0, ["a"], bucket=bucket, shuffle=7, batch=4) for found in (table, mixed))
    assert order(one) == order(other) and one.state() == other.state()


def test_threads_read_the_same(bucket, monkeypatch):
    import mocapd.archive._windows as module

    monkeypatch.setattr(module, "OPEN_TAKES", 1)
    windows = archive.windows(rows(bucket), 0.2, 50.0, ["a"], bucket=bucket, shuffle=7, batch=2)
    expected = [batch["positions"] for batch in windows]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda part: [batch for batch in windows.rows(part)], windows.parts(1)))
    found = [np.array(batch.column("positions").to_pylist()) for (batch,) in found]
    assert len(found) == len(expected) > 20
    assert all(np.array_equal(one, other.reshape(len(other), -1)) for one, other in zip(found, expected))


def test_arrow_batches_hold_tensors(bucket):
    windows = archive.windows(rows(bucket), 1.0, 50.0, ["a", "b"], bucket=bucket, batch=5)
    assert len(windows) > 1
    for batch, arrow in zip(windows, windows.arrow()):
        assert isinstance(arrow, pa.RecordBatch) and arrow.num_rows == len(batch["valid"])
        assert np.array_equal(arrow.column("positions").to_numpy_ndarray(), batch["positions"])
        assert np.array_equal(arrow.column("valid").to_numpy_ndarray(), batch["valid"])


def test_torch_batches_hold_tensors(bucket):
    torch = pytest.importorskip("torch")
    windows = archive.windows(rows(bucket), 1.0, 50.0, ["a", "b"], bucket=bucket)
    batches = list(windows.torch())
    assert sum(len(batch["valid"]) for batch in batches) == len(windows.places) > 0
    for batch in batches:
        assert batch["positions"].dtype == torch.float32 and batch["valid"].dtype == torch.bool
        assert batch["positions"].shape[1:] == (50, 2, 3)


def test_wrong_windows_are_refused(bucket):
    table = rows(bucket)
    for seconds, hz, more in ((0, 1, {}), (1, 0, {}), (0.001, 1, {}), (1, 1, {"batch": 0}), (1, 1, {"shard": (1, 1)})):
        with pytest.raises(ValueError):
            archive.windows(table, seconds, hz, ["a"], bucket=bucket, **more)
    with pytest.raises(ValueError, match="shard"):
        archive.windows(table, 1, 1, ["a"], bucket=bucket).sharded(5, 3)
    with pytest.raises(ValueError, match="their markers are a, b"):
        archive.windows("select * from takes", 1, 1, ["a", "LKNE"], bucket=bucket)
    with pytest.raises(ValueError, match="frames"):
        archive.windows(table.select(["object", "rate_hz"]), 1, 1, ["a"], bucket=bucket)
