"""What fails in an archive, and what the same command does then."""

import errno
import json
import os
import re
import stat
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from deltalake.exceptions import CommitFailedError, DeltaError

archive = pytest.importorskip("mocapd.archive")

import mocapd._native as mocapd_native  # noqa: E402
import mocapd.archive.__main__ as command_module  # noqa: E402
import mocapd.archive._catalogue as catalogue_module  # noqa: E402
import mocapd.archive._ingest as ingest_module  # noqa: E402
import mocapd.archive._upkeep as upkeep_module  # noqa: E402
import mocapd.archive._workers as workers_module  # noqa: E402
from made import c3d, c3d_file, channel_records, motion, write_c3ds  # noqa: E402
from mocapd.archive._keys import source_hash  # noqa: E402
from mocapd.archive._lease import leases, writing  # noqa: E402


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch):
    monkeypatch.setattr(workers_module, "WAIT_S", 0.001)


def ingest(folder, bucket, **options):
    return archive.ingest(folder, bucket, workers=0, progress=False, **options)


def takes(bucket):
    rows = archive.catalogue(bucket).arrow().to_pylist()
    return [row for row in rows if row["status"] == "take"]


def test_a_file_system_that_cannot_sync_folders(tmp_path, monkeypatch):
    """As that of a Windows drive in WSL; other errors of the disk are errors of the store."""
    sync, code = os.fsync, errno.EINVAL

    def fsync(file):
        if stat.S_ISDIR(os.fstat(file).st_mode):
            raise OSError(code, os.strerror(code))
        sync(file)

    monkeypatch.setattr(os, "fsync", fsync)
    write_c3ds(tmp_path / "c3d", 2)
    assert ingest(tmp_path / "c3d", tmp_path / "archive").takes == 2
    code = errno.EIO
    with pytest.raises(archive.StoreError):
        ingest(tmp_path / "c3d", tmp_path / "other")


def test_lost_and_damaged_takes_are_imported_again(tmp_path):
    bucket = tmp_path / "archive"
    write_c3ds(tmp_path / "c3d", 5)
    ingest(tmp_path / "c3d", bucket)
    good = {row["object"]: (bucket / row["object"]).read_bytes() for row in takes(bucket)}
    lost, cut, changed, *_ = sorted(good)
    (bucket / lost).unlink()
    (bucket / cut).write_bytes(good[cut][:-1])
    (bucket / changed).write_bytes(good[changed][:-1] + b"?")
    report = archive.verify(bucket, workers=0)
    assert report.missing == [lost] and [name for name, _ in report.damaged] == sorted([cut, changed])
    # Another source of a damaged take fails with a reason, and without a row that stays.
    report = ingest(tmp_path / "c3d", bucket)
    assert (report.failed, report.takes) == (1, 0) and cut in report.errors[0][1]
    assert (bucket / lost).read_bytes() == good[lost]
    # The way that the page describes: remove what is damaged, and repeat the command.
    (bucket / cut).unlink()
    (bucket / changed).unlink()
    report = ingest(tmp_path / "c3d", bucket)
    assert report.failed == 0 and {name: (bucket / name).read_bytes() for name in good} == good
    assert archive.verify(bucket, workers=0).is_intact
    assert archive.catalogue(bucket).arrow().num_rows == 5


def test_a_lost_repacked_take_is_imported_again(tmp_path):
    bucket = tmp_path / "archive"
    write_c3ds(tmp_path / "c3d", 2, frames=400)
    options = {"tolerance": None, "resampler": "lossless"}
    ingest(tmp_path / "c3d", bucket, **options)
    assert archive.repack(bucket, workers=0).repacked == 2
    # A copy under another name belongs to the repacked take.
    (tmp_path / "c3d" / "copy.c3d").write_bytes(c3d(0, frames=400))
    assert ingest(tmp_path / "c3d", bucket, **options).duplicates == 1
    repacked = {row["key"]: row["object"] for row in takes(bucket)}
    rows = archive.catalogue(bucket).arrow().to_pylist()
    assert all(row["object"] == repacked[row["key"]] for row in rows)
    archive.collect(bucket, older_than_s=0, remove=True)
    for name in repacked.values():
        (bucket / name).unlink()
    assert ingest(tmp_path / "c3d", bucket, **options).failed == 0
    assert archive.verify(bucket, workers=0).is_intact and len(takes(bucket)) == 2
    assert archive.collect(bucket, older_than_s=0) == []




@pytest.mark.parametrize("error", [DeltaError("no answer"), OSError("no answer"), KeyboardInterrupt()])
def test_a_commit_whose_answer_is_lost_is_not_repeated(error, tmp_path, monkeypatch):
    write = catalogue_module.write_deltalake
    bucket, failures = tmp_path / "archive", [True]
    write_c3ds(tmp_path / "c3d", 4)

    def write_and_fail(*args, **options):
        write(*args, **options)
        if failures:
            failures.pop()
            raise error

    monkeypatch.setattr(catalogue_module, "write_deltalake", write_and_fail)
    if isinstance(error, KeyboardInterrupt):
        with pytest.raises(KeyboardInterrupt):
            ingest(tmp_path / "c3d", bucket)
    else:
        assert ingest(tmp_path / "c3d", bucket).takes == 4
    assert len(takes(bucket)) == 4 and not failures
    ingest(tmp_path / "c3d", bucket)
    assert len(takes(bucket)) == 4


def test_a_commit_that_fails_is_repeated_and_then_ends_the_ingest(tmp_path, monkeypatch):
    write = catalogue_module.write_deltalake
    bucket, failures = tmp_path / "archive", [True] * 3
    write_c3ds(tmp_path / "c3d", 4)

    def fail_and_write(*args, **options):
        if failures:
            failures.pop()
            raise DeltaError("no answer")
        write(*args, **options)

    monkeypatch.setattr(catalogue_module, "write_deltalake", fail_and_write)
    assert ingest(tmp_path / "c3d", bucket).takes == len(takes(bucket)) == 4
    failures.extend([True] * 99)
    write_c3ds(tmp_path / "c3d", 8)
    with pytest.raises(archive.StoreError, match="no answer"):
        ingest(tmp_path / "c3d", bucket)
    failures.clear()
    assert ingest(tmp_path / "c3d", bucket).takes == 4 and len(takes(bucket)) == 8


def test_each_bad_file_is_a_row_and_the_others_continue(tmp_path):
    folder, bucket = tmp_path / "c3d", tmp_path / "archive"
    write_c3ds(folder, 2)
    (folder / "bad.c3d").write_bytes(b"no C3D file")
    (folder / "empty.c3d").write_bytes(b"")
    (folder / "empty.csv").write_bytes(b"")
    (folder / "hostile.take").write_bytes(b"\x89TAK\r\n\x1a\n" + b"\xff" * 100)
    (folder / "gone.c3d").symlink_to(folder / "nothing.c3d")
    (folder / "gone.txt").symlink_to(folder / "nothing.txt")
    (folder / "back").symlink_to(folder)
    (folder / "c3d").write_bytes(b"not of this format, only of this name")
    with open(os.fsencode(folder) + b"/M\xfcller.c3d", "wb") as file:
        file.write(c3d(7))
    report = ingest(folder, bucket, names=r"/(?P<subject>[^/]+)\.")
    assert (report.files, report.takes, report.failed) == (8, 3, 5), report.errors
    rows = archive.catalogue(bucket).sql("select source from failures order by source").column("source").to_pylist()
    assert [row.rpartition("/")[2] for row in rows] == ["bad.c3d", "empty.c3d", "empty.csv", "gone.c3d", "hostile.take"]
    (row,) = archive.catalogue(bucket).sql("select subject from takes where source like '%ller.c3d'").to_pylist()
    assert row["subject"] == "M\\xfcller"
    # What was corrected is no failure any more; the others are not tried again, and not forgotten.
    (folder / "bad.c3d").write_bytes(c3d(8))
    report = ingest(folder, bucket, names=r"/(?P<subject>[^/]+)\.")
    assert (report.takes, report.failed, report.failed_before) == (1, 0, 4)
    assert len(archive.catalogue(bucket).sql("select source from failures")) == 4


def test_a_source_is_one_however_it_is_named(tmp_path, monkeypatch):
    folder, bucket = tmp_path / "J\u00fcrgen K#1", tmp_path / "an archive?#"
    write_c3ds(folder, 2)
    (tmp_path / "link").symlink_to(folder)
    monkeypatch.chdir(tmp_path)
    names = r"/(?P<subject>[^/]+)/s\d/"
    assert ingest(folder, bucket, names=names).takes == 2
    for other in (tmp_path, f"file://{folder}", "link/", f"{folder}/s0/../", folder / "s0" / "day0" / "walk0000.c3d"):
        report = ingest(other, bucket, names=names)
        assert report.takes == report.duplicates == 0 and report.unchanged > 0, other
    assert {row["subject"] for row in takes(bucket)} == {"J\u00fcrgen K#1"}
    assert archive.verify(bucket, workers=0).is_intact
    with pytest.raises(ValueError, match="%"):
        ingest(folder, tmp_path / "100%")


def test_the_archive_is_no_source_of_itself(tmp_path):
    write_c3ds(tmp_path / "c3d", 2)
    for _ in range(2):
        assert ingest(tmp_path, tmp_path / "archive").files == 2
    assert ingest([tmp_path / "c3d", tmp_path / "c3d" / "s0"], tmp_path / "archive").files == 2


def test_nothing_is_removed_while_takes_are_added(tmp_path):
    bucket = tmp_path / "archive"
    write_c3ds(tmp_path / "c3d", 3)
    ingest(tmp_path / "c3d", bucket)
    store = archive.open_store(bucket)
    assert leases(store) == []
    key = "ab" + "0" * 62
    store.put_if_absent(archive.object_name(key), b"no row yet")
    os.utime(bucket / archive.object_name(key), (0, 0))
    with writing(store):
        assert len(leases(store)) == 1
        assert len(archive.collect(bucket)) == 1
        with pytest.raises(archive.StoreError, match="is running"):
            archive.collect(bucket, remove=True)
    assert len(archive.collect(bucket, remove=True)) == 1


def test_what_a_row_named_today_is_kept(tmp_path):
    bucket = tmp_path / "archive"
    write_c3ds(tmp_path / "c3d", 3, frames=400)
    ingest(tmp_path / "c3d", bucket, tolerance=None, resampler="lossless")
    before = {row["object"] for row in takes(bucket)}
    for name in before:
        os.utime(bucket / name, (0, 0))
    assert archive.repack(bucket, workers=0).repacked == 3
    archive.catalogue(bucket).delete(f"key = '{takes(bucket)[0]['key']}'")
    assert archive.collect(bucket, remove=True) == []
    removed = {entry.name for entry in archive.collect(bucket, remove=True, older_than_s=0)}
    assert removed > before and len(removed) == 4
    archive.catalogue(bucket).delete("true")
    with pytest.raises(archive.StoreError, match="no row"):
        archive.collect(bucket, remove=True, older_than_s=0)


def test_rows_of_two_ingests_at_once_do_not_stop_a_repack(tmp_path):
    bucket = tmp_path / "archive"
    write_c3ds(tmp_path / "c3d", 2, frames=400)
    ingest(tmp_path / "c3d", bucket, tolerance=None, resampler="lossless")
    table = archive.catalogue(bucket)
    table.append(table.arrow().to_batches(), "another run", 1)
    report = archive.repack(bucket, workers=0)
    assert (report.takes, report.repacked) == (2, 2)
    assert archive.verify(bucket, workers=0).is_intact


def between_reading_and_writing(monkeypatch, *others):
    """Runs something before each commit of rows, after the table was read for it; None for nothing."""
    write, waiting = catalogue_module.write_deltalake, list(others)

    def write_after_another(*args, **options):
        if waiting and (other := waiting.pop(0)) is not None:
            with monkeypatch.context() as undisturbed:
                undisturbed.setattr(catalogue_module, "write_deltalake", write)
                other()
        write(*args, **options)

    monkeypatch.setattr(catalogue_module, "write_deltalake", write_after_another)


def test_two_ingests_at_once_list_each_file_once(tmp_path, monkeypatch):
    bucket, folder = tmp_path / "archive", tmp_path / "c3d"
    paths = write_c3ds(folder, 9)
    (folder / "bad.c3d").write_bytes(b"no C3D file" * 100)
    (tmp_path / "copies").mkdir()
    for path in paths[:2]:
        (tmp_path / "copies" / path.name).write_bytes(path.read_bytes())
    monkeypatch.setattr(ingest_module, "COMMIT_ROWS", 3)
    reports = []

    def another(*sources):
        reports.append(ingest(list(sources), bucket, batch_files=1))

    # Another process makes the table, adds rows of other files, and all that are left.
    between_reading_and_writing(
        monkeypatch, lambda: another(paths[8]), None, lambda: another(tmp_path / "copies"), lambda: another(folder)
    )
    another(folder)
    rows = archive.catalogue(bucket).arrow().to_pylist()
    statuses = sorted(row["status"] for row in rows)
    assert statuses == ["duplicate"] * 2 + ["failed"] + ["take"] * 9 and len({row["source"] for row in rows}) == 12
    objects = {entry.name for entry in archive.open_store(bucket).list("takes/")}
    assert {row["object"] for row in takes(bucket)} == objects and len(objects) == 9
    assert {row["object"] for row in rows if row["status"] == "duplicate"} < objects
    # Each report has each file once.
    for report in reports:
        assert report.takes + report.duplicates + report.failed + report.unchanged == report.files
    assert sum(report.takes for report in reports) == 9 and sum(report.duplicates for report in reports) == 2


def test_commits_of_many_others_are_no_failures_of_the_store(tmp_path, monkeypatch):
    bucket = tmp_path / "archive"
    mine, *others = write_c3ds(tmp_path / "c3d", 9)
    assert len(others) > workers_module.ATTEMPTS
    between_reading_and_writing(monkeypatch, *[lambda path=path: ingest(path, bucket) for path in others])
    assert ingest(mine, bucket).takes == 1
    assert len(takes(bucket)) == 9 and archive.verify(bucket, workers=0).is_intact


def test_too_many_commits_of_others_end_an_ingest(tmp_path, monkeypatch):
    bucket, conflicts = tmp_path / "archive", []
    write_c3ds(tmp_path / "c3d", 2)

    def come_second(*args, **options):
        conflicts.append(None)
        raise CommitFailedError("Failed to commit transaction: 0")

    with monkeypatch.context() as patched:
        patched.setattr(catalogue_module, "write_deltalake", come_second)
        with pytest.raises(archive.StoreError, match="committed first 31 times.*Failed to commit"):
            ingest(tmp_path / "c3d", bucket)
    assert len(conflicts) == 31
    assert ingest(tmp_path / "c3d", bucket).takes == 2


def test_a_table_that_cannot_be_read_again_is_read_by_the_next_attempt(tmp_path, monkeypatch):
    bucket, failures = tmp_path / "archive", []
    write_c3ds(tmp_path / "c3d", 3)
    read = catalogue_module._read

    def fail_once(*args):
        if failures:
            raise failures.pop()
        return read(*args)

    def another():
        ingest(tmp_path / "c3d", bucket)
        failures.append(archive.StoreError("no answer"))

    monkeypatch.setattr(catalogue_module, "_read", fail_once)
    between_reading_and_writing(monkeypatch, another)
    report = ingest(tmp_path / "c3d", bucket)
    assert (report.takes, report.unchanged) == (0, 3) and not failures
    assert archive.catalogue(bucket).arrow().num_rows == 3


def test_two_ingests_that_repair_a_take_list_its_further_sources_once(tmp_path, monkeypatch):
    bucket, folder = tmp_path / "archive", tmp_path / "c3d"
    (path, *_) = write_c3ds(folder, 1)
    ingest(folder, bucket)
    (row,) = takes(bucket)
    (bucket / row["object"]).unlink()
    # A commit before those of the lost take, whose further source follows its repair.
    (tmp_path / "new").mkdir()
    first, copy = tmp_path / "new" / "a.c3d", tmp_path / "new" / "b.c3d"
    first.write_bytes(c3d(99))
    copy.write_bytes(path.read_bytes())
    monkeypatch.setattr(ingest_module, "COMMIT_ROWS", 1)
    between_reading_and_writing(monkeypatch, lambda: ingest([path, copy], bucket))
    report = ingest([first, copy, path], bucket, batch_files=1)
    assert (report.takes, report.duplicates, report.unchanged) == (1, 0, 2)
    rows = archive.catalogue(bucket).arrow().to_pylist()
    assert sorted(row["status"] for row in rows) == ["duplicate", "take", "take"]
    assert len({row["source"] for row in rows}) == 3 and archive.verify(bucket, workers=0).is_intact


def test_a_repack_beside_an_ingest(tmp_path, monkeypatch):
    bucket, folder = tmp_path / "archive", tmp_path / "c3d"
    (path, *_) = write_c3ds(folder, 3, frames=400)
    options = {"tolerance": None, "resampler": "lossless"}
    ingest(folder, bucket, **options)
    (folder / "copy.c3d").write_bytes(path.read_bytes())
    between_reading_and_writing(monkeypatch, lambda: archive.repack(bucket, workers=0))
    assert ingest(folder, bucket, **options).duplicates == 1
    archive.collect(bucket, remove=True, older_than_s=0)
    # The copy, too, has the new object.
    rows = archive.catalogue(bucket).arrow().to_pylist()
    objects = {entry.name for entry in archive.open_store(bucket).list("takes/")}
    assert len(rows) == 4 and {row["object"] for row in rows} == objects and len(objects) == 3


def test_a_take_whose_row_was_deleted_is_listed_again_by_its_other_source(tmp_path):
    bucket = tmp_path / "archive"
    (old, _) = write_c3ds(tmp_path / "old", 2)
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "a.c3d").write_bytes(old.read_bytes())
    ingest(tmp_path / "old", bucket)
    assert ingest(tmp_path / "new", bucket).duplicates == 1
    archive.catalogue(bucket).delete("source like '%/old/%'")
    assert takes(bucket) == []
    assert ingest(tmp_path / "new", bucket).takes == 1 and len(takes(bucket)) == 1


def test_folders_without_files_without_names(tmp_path, monkeypatch):
    """As on NFS."""
    monkeypatch.delattr(os, "O_TMPFILE")
    store = archive.FolderStore(tmp_path / "a")
    assert store.put_if_absent("x/y", b"one") and not store.put_if_absent("x/y", b"one")
    path = tmp_path / "a" / "x" / "y"
    mask = os.umask(0)
    os.umask(mask)
    assert path.read_bytes() == b"one" and stat.S_IMODE(path.stat().st_mode) == 0o644 & ~mask
    assert os.listdir(path.parent) == ["y"]


def failing_reads(monkeypatch, errors):
    """Lets reads of objects fail: a dict of the ends of names with their errors."""
    read = archive.FolderStore.get

    def get(self, name):
        for end, error in errors.items():
            if name.endswith(end):
                raise error
        return read(self, name)

    monkeypatch.setattr(archive.FolderStore, "get", get)


def test_verify_and_repack_go_on_past_takes_that_cannot_be_read(tmp_path, monkeypatch):
    bucket = tmp_path / "archive"
    write_c3ds(tmp_path / "c3d", 4, frames=400)
    ingest(tmp_path / "c3d", bucket, tolerance=None, resampler="lossless")
    sector, locked, *_ = names = sorted(row["object"] for row in takes(bucket))
    errors = {sector: OSError(errno.EIO, "bad sector"), locked: PermissionError(errno.EACCES, "not yours")}
    failing_reads(monkeypatch, errors)
    report = archive.verify(bucket, workers=0)
    assert report.damaged == [(sector, "cannot be read: bad sector"), (locked, "cannot be read: not yours")]
    assert report.missing == [] and report.takes == 4 and report.n_bytes > 0
    repacked = archive.repack(bucket, workers=0)
    assert (repacked.repacked, dict(repacked.failed)) == (2, dict(report.damaged))
    # A share that is gone, and a machine without files, end both.
    for number in (errno.ESTALE, errno.EMFILE):
        errors[sector] = OSError(number, "gone")
        for command in (archive.verify, archive.repack):
            with pytest.raises(archive.StoreError, match=f"{names[0]}.*gone"):
                command(bucket, workers=0)


def test_a_damaged_object_of_a_former_repack_is_a_failure_of_its_take(tmp_path):
    bucket = tmp_path / "archive"
    write_c3ds(tmp_path / "c3d", 3, frames=400)
    ingest(tmp_path / "c3d", bucket, tolerance=None, resampler="lossless")
    row, *_ = takes(bucket)
    new = mocapd_native.repack_take((bucket / row["object"]).read_bytes())
    orphan = archive.object_name(row["key"], source_hash(new))
    (bucket / orphan).write_bytes(new[:-1])
    report = archive.repack(bucket, workers=0)
    assert report.repacked == 2
    ((name, error),) = report.failed
    assert name == row["object"] and orphan in error and "remove this object" in error
    (bucket / orphan).unlink()
    assert archive.repack(bucket, workers=0).repacked == 1


MACHINE = [
    OSError(errno.ENOSPC, "No space left"),
    OSError(errno.EMFILE, "Too many open files"),
    BlockingIOError(errno.EAGAIN, "no thread"),
    OSError(errno.ENOMEM, "Cannot allocate"),
    # As the import states its temporary files.
    OSError("cannot write the analog samples of the take to a temporary file"),
    MemoryError(),
]


@pytest.mark.parametrize("error", MACHINE, ids=repr)
def test_trouble_of_the_machine_is_no_failure_of_a_file(error, tmp_path, monkeypatch):
    bucket = tmp_path / "archive"
    write_c3ds(tmp_path / "c3d", 3)

    def fail(*_):
        raise error

    with monkeypatch.context() as patched:
        patched.setattr(ingest_module, "import_motion", fail)
        with pytest.raises(archive.StoreError, match="on this machine"):
            ingest(tmp_path / "c3d", bucket)
    if error.args[1:] or isinstance(error, MemoryError):
        with monkeypatch.context() as patched:
            failing_reads(patched, {".c3d": error})
            with pytest.raises(archive.StoreError, match="cannot read"):
                ingest(tmp_path / "c3d", bucket)
    put, name, reason = archive.FolderStore.put_if_absent, "s0/day0/walk0000.c3d", str(error) or "out of memory"

    def fail_to_put(self, name, data):
        return fail() if name.startswith("takes/") else put(self, name, data)

    with monkeypatch.context() as patched:
        patched.setattr(archive.FolderStore, "put_if_absent", fail_to_put)
        with pytest.raises(archive.StoreError, match=f"cannot write takes/.*{name}: {re.escape(reason)}"):
            ingest(tmp_path / "c3d" / name, bucket)
    assert archive.catalogue(bucket).arrow().num_rows == 0
    report = ingest(tmp_path / "c3d", bucket)
    assert (report.takes, report.failed_before) == (3, 0)


def test_no_new_thread_is_no_failure_of_a_file(tmp_path, monkeypatch):
    write_c3ds(tmp_path / "c3d", 3)

    def submit(*_):
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patched:
        patched.setattr(ingest_module.ThreadPoolExecutor, "submit", submit)
        with pytest.raises(archive.StoreError, match=r"\.c3d on this machine: can't start new thread"):
            ingest(tmp_path / "c3d", tmp_path / "archive")
    assert ingest(tmp_path / "c3d", tmp_path / "archive").takes == 3


class Bucket:
    """A store that is no folder, and knows in which threads takes are stored."""

    def __init__(self, path):
        self._folder = archive.FolderStore(path)
        self.url, self.threads = self._folder.url, set()
        for name in ("get", "size", "list", "remove", "open_take"):
            setattr(self, name, getattr(self._folder, name))

    def put_if_absent(self, name, data):
        if name.startswith("takes/"):
            self.threads.add(threading.current_thread())
        return self._folder.put_if_absent(name, data)


def test_takes_are_uploaded_in_the_thread_that_ctrl_c_interrupts(tmp_path):
    write_c3ds(tmp_path / "c3d", 3)
    bucket = Bucket(tmp_path / "archive")
    assert ingest(tmp_path / "c3d", bucket).takes == 3
    assert bucket.threads == {threading.main_thread()}


def test_no_folder_for_temporary_files_is_no_failure_of_a_file(tmp_path, monkeypatch):
    (tmp_path / "c3d").mkdir()
    frames, per_frame, channels = 12_000, 10, 20
    analog = np.random.default_rng(1).normal(0, 1, (frames * per_frame, channels))
    data = c3d_file(motion(1, frames), analog, per_frame, channel_records(channels), rate_hz=100.0)
    (tmp_path / "c3d" / "long.c3d").write_bytes(data)
    with monkeypatch.context() as patched:
        patched.setenv("TMPDIR", str(tmp_path / "none"))
        with pytest.raises(archive.StoreError, match="TMPDIR"):
            ingest(tmp_path / "c3d", tmp_path / "archive")
    assert ingest(tmp_path / "c3d", tmp_path / "archive").takes == 1


def test_a_locked_folder_is_a_failed_row_and_the_others_continue(tmp_path, monkeypatch):
    folder, bucket = tmp_path / "c3d", tmp_path / "archive"
    write_c3ds(folder, 3)
    locked = folder / "deep" / "lost+found"
    locked.mkdir(parents=True)
    scan = os.scandir

    def scandir(path="."):
        # Root may list all folders.
        if os.fspath(path) == str(locked):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return scan(path)

    monkeypatch.setattr(os, "scandir", scandir)
    report = ingest(folder, bucket)
    assert (report.takes, report.failed) == (3, 1)
    ((source, error),) = report.errors
    assert source == f"file://{locked}" and "may not be listed" in error
    report = ingest(folder, bucket)
    assert (report.failed, report.failed_before, report.unchanged) == (0, 1, 4)
    # The archive itself has none: what is in it would be taken for missing.
    locked = bucket / "takes"
    with pytest.raises(PermissionError):
        archive.verify(bucket, workers=0)
    locked = folder
    with pytest.raises(PermissionError):
        ingest(folder, bucket)


class FakeRay:
    """Ray, every task of which ends with an error."""

    def __init__(self, name, *words):
        self.exceptions = pytest.importorskip("ray").exceptions
        self.error = getattr(self.exceptions, name)(*words)

    def put(self, value):
        return value

    def remote(self, **_):
        return lambda _: SimpleNamespace(remote=lambda *_: object())

    def cluster_resources(self):
        return {"CPU": 1}

    def wait(self, references, num_returns):
        return references[:1], references[1:]

    def cancel(self, *_, **__):
        pass

    def get(self, _):
        raise self.error


@pytest.mark.parametrize("name", ["RuntimeEnvSetupError", "RaySystemError", "TaskUnschedulableError", "OutOfDiskError"])
def test_trouble_of_ray_is_no_failure_of_a_file(name):
    fake = FakeRay(name, "no such environment")
    with pytest.raises(archive.StoreError, match=f"(?s){name}.*no such environment"):
        list(workers_module._on_ray(fake, None, [["a", "b"]], 1, lambda item, reason: reason))


@pytest.mark.parametrize("name", ["WorkerCrashedError", "OutOfMemoryError", "NodeDiedError"])
def test_a_killed_worker_is_a_failure_with_its_reason(name):
    fake = FakeRay(name, *([] if name == "WorkerCrashedError" else ["killed\nmore"]))
    found = list(workers_module._on_ray(fake, None, [["a", "b"]], 1, lambda item, reason: (item, reason)))
    assert sorted(item for item, _ in found) == [["a"], ["b"]]
    assert all(name in reason and "\n" not in reason for _, (_, reason) in found)


def test_takes_that_end_their_worker_are_lines_of_the_reports(tmp_path, monkeypatch):
    bucket = tmp_path / "archive"
    write_c3ds(tmp_path / "c3d", 2)
    ingest(tmp_path / "c3d", bucket)

    def end_each(run, items, workers, lost=None):
        return workers_module._on_ray(FakeRay("WorkerCrashedError"), run, items, workers, lost)

    monkeypatch.setattr(upkeep_module, "run_tasks", end_each)
    names = {row["object"] for row in takes(bucket)}
    for found in (archive.verify(bucket).damaged, archive.repack(bucket).failed):
        assert {name for name, _ in found} == names
        assert all("ended the process 5 times" in error and "WorkerCrashed" in error for _, error in found)


def test_an_axis_that_points_down_on_the_command_line(tmp_path, monkeypatch, capsys):
    write_c3ds(tmp_path / "c3d", 2)
    for up in (["--up", "-z"], ["--up=-z"]):
        words = ["ingest", str(tmp_path / "c3d"), "-b", str(tmp_path / "archive"), "--workers", "0", *up]
        monkeypatch.setattr(sys, "argv", ["mocapd archive", *words])
        assert command_module.main() == 0, capsys.readouterr().err
    assert {json.loads(row["settings"])["up"] for row in takes(tmp_path / "archive")} == {"-z"}
    assert len(takes(tmp_path / "archive")) == 2


def test_ray_gets_no_folder_of_others(tmp_path, monkeypatch):
    """Its workers import modules from the folders that the configuration of the job names."""
    ray = pytest.importorskip("ray")
    jobs = []

    def init(job_config=None, **_):
        # As Ray does: the folder of the script, and the current one.
        if job_config is not None:
            job_config._py_driver_sys_path += ["/opt/scripts", os.getcwd()]
            jobs.append(job_config)

    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "init", init)
    monkeypatch.setattr(ray, "shutdown", lambda: None)
    monkeypatch.setattr(workers_module, "_on_ray", lambda *_: iter(()))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    for _ in range(2):
        assert list(workers_module.run_tasks(len, [["a"]], None)) == []
        # Of a cluster.
        monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:6379")
    assert len(jobs) == 2 and os.getcwd() == str(tmp_path)
    for job in jobs:
        sent = job._serialize()
        assert b"/opt/scripts" in sent and os.fsencode(tmp_path) not in sent
