"""Archives in a bucket, of a test store that speaks S3."""

import os
import select
import signal
import time

import numpy as np
import pytest

import mocapd

archive = pytest.importorskip("mocapd.archive")

from made import RATE_HZ, c3d, motion, write_c3ds  # noqa: E402

LABELS = ["a", "b", "c", "d"]


@pytest.fixture(scope="module")
def bucket(endpoint, tmp_path_factory):
    """An archive in a folder of the bucket: 6 files, a duplicate, and one that is no C3D file."""
    folder = tmp_path_factory.mktemp("c3d")
    paths = write_c3ds(folder, 6)
    (folder / "copy.c3d").write_bytes(paths[0].read_bytes())
    (folder / "bad.c3d").write_bytes(b"no C3D file" * 100)
    url = f"s3://takes-test/lab/{os.getpid()}"
    report = archive.ingest(folder, url, workers=0, progress=False)
    assert (report.takes, report.duplicates, report.failed) == (6, 1, 1)
    assert archive.ingest(folder, url, workers=0, progress=False).unchanged == 8
    return url


def test_each_content_is_there_once(bucket):
    rows = archive.catalogue(bucket).sql("select object, take_bytes from takes order by object").to_pylist()
    entries = list(archive.open_store(bucket).list("takes/"))
    assert [(entry.name, entry.n_bytes) for entry in entries] == [(row["object"], row["take_bytes"]) for row in rows]
    assert len(rows) == 6 and all(abs(time.time() - entry.modified_s) < 600 for entry in entries)
    assert archive.verify(bucket, workers=0).is_intact
    assert archive.collect(bucket, older_than_s=0) == []


def test_an_object_is_never_replaced(bucket):
    store = archive.open_store(bucket)
    assert store.put_if_absent("more/x", b"one") and not store.put_if_absent("more/x", b"one")
    with pytest.raises(FileExistsError):
        store.put_if_absent("more/x", b"two")
    assert store.get("more/x") == b"one"
    assert store.size("more/x") == 3 and store.size("more/y") is None
    with pytest.raises(FileNotFoundError):
        store.get("more/y")
    store.remove("more/x")
    store.remove("more/x")
    assert list(store.list("more/")) == []


def test_large_objects_are_stored_whole(bucket):
    store = archive.open_store(bucket)
    for number, data in enumerate((b"x", os.urandom(9 << 20))):
        assert store.put_if_absent(f"large/{number}", data) and store.get(f"large/{number}") == data
        assert not store.put_if_absent(f"large/{number}", data)
    assert [entry.n_bytes for entry in store.list("large/")] == [1, 9 << 20]


def test_a_folder_with_the_name_of_a_format_is_a_folder(bucket, tmp_path):
    store = archive.open_store("s3://takes-test/c3d")
    store.put_if_absent("a.c3d", c3d(1))
    store.put_if_absent("c3d", b"no file of motion")
    for source, files in (("s3://takes-test/c3d/", 1), ("s3://takes-test/c3d", 1), ("s3://takes-test/c3d/a.c3d", 1)):
        assert archive.ingest(source, tmp_path / "archive", workers=0, progress=False).files == files
    assert archive.catalogue(tmp_path / "archive").arrow().num_rows == 1
    with pytest.raises(FileNotFoundError):
        archive.ingest("s3://takes-test/none/", tmp_path / "archive", workers=0, progress=False)


def test_a_forked_process_reads_with_connections_of_its_own(bucket):
    found = archive.windows("select * from takes", 0.5, RATE_HZ, ["M1"], bucket=bucket, batch=3)
    expected = [batch["positions"].sum() for batch in found]
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            same = [batch["positions"].sum() for batch in found] == expected
            os.write(writing, b"same" if same else b"different")
        finally:
            os._exit(0)
    os.close(writing)
    ready, _, _ = select.select([reading], [], [], 20)
    if not ready:
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    assert ready and os.read(reading, 100) == b"same"
    os.close(reading)


def test_takes_move_from_a_folder_to_a_bucket_unchanged(bucket, tmp_path):
    """Sources may be in a bucket, too."""
    report = archive.ingest(f"{bucket}/takes", tmp_path / "archive", workers=0, progress=False)
    assert report.takes == 6 and archive.verify(tmp_path / "archive", workers=0).is_intact
    stored = {path.read_bytes() for path in (tmp_path / "archive" / "takes").glob("**/*.take")}
    store = archive.open_store(bucket)
    assert stored == {store.get(entry.name) for entry in store.list("takes/")}


@pytest.mark.parametrize("resampler, tolerance", [("dense", 0.5), ("fast", 0.05), ("lossless", None)])
def test_a_window_costs_at_most_three_requests(resampler, tolerance, endpoint, tmp_path):
    """A second of a minute, at random; the bytes are a part of the take's. Run with -s it prints the page's table."""
    url = f"s3://takes-test/windows/{resampler}/{os.getpid()}"
    for number in range(2):
        points = motion(number, frames=6000, markers=30)
        labels = [f"m{at}" for at in range(30)]
        mocapd.write_take(tmp_path / f"{number}.take", points, labels, RATE_HZ, tolerance, resampler)
    archive.ingest(tmp_path, url, workers=0, progress=False)
    sizes = [entry.n_bytes for entry in archive.open_store(url).list("takes/")]
    found = archive.windows("select * from takes", 1.0, RATE_HZ, ["m3", "m7"], bucket=url, shuffle=5, batch=1)
    requests, n_bytes = [], []
    for windows in (found.after(number) for number in range(20)):
        # Each as the first window of its take.
        store = archive.open_store(url)
        windows.form.store = store
        windows.form._takes.clear()
        batch = next(iter(windows))
        assert batch["valid"].any()
        requests.append(store.traffic()[0])
        n_bytes.append(store.traffic()[1])
    n_tail = 64 << 10
    mean = np.mean(n_bytes)
    print(f"| `{resampler}` | {np.mean(sizes):.0f} | {np.mean(requests):.2f} | {max(requests)} | {mean:.0f} |")
    assert max(requests) <= 3
    # A window is in a stretch of ten seconds, or in two.
    assert mean < n_tail + 0.4 * np.mean(sizes)


def test_windows_in_a_bucket_are_those_in_a_folder(endpoint, tmp_path):
    url = f"s3://takes-test/same/{os.getpid()}"
    for number in range(3):
        mocapd.write_take(tmp_path / f"{number}.take", motion(number, frames=500), LABELS, RATE_HZ, 0.5)
    batches = []
    for bucket in (url, tmp_path / "archive"):
        archive.ingest([tmp_path / f"{number}.take" for number in range(3)], bucket, workers=0, progress=False)
        takes = archive.catalogue(bucket).sql("select * from takes order by source")
        batches.append(list(archive.windows(takes, 0.7, 73.0, ["b", "d"], bucket=bucket, batch=50)))
    ((one,), (other,)) = batches
    for name in ("positions", "valid", "time_s", "object"):
        assert np.array_equal(one[name], other[name])


def test_errors_of_the_store_say_what_to_do(endpoint, monkeypatch):
    with pytest.raises(FileNotFoundError, match="no-such-bucket"):
        archive.open_store("s3://no-such-bucket/x").get("y")
    with pytest.raises(ValueError, match="s3://"):
        archive.open_store("ftp://host/x")
