"""Archives on Ray: killed workers, drivers and stores leave each content once, with one row."""

import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

archive = pytest.importorskip("mocapd.archive")
ray = pytest.importorskip("ray")

from made import RATE_HZ, write_c3ds  # noqa: E402

# Ray's own.
pytestmark = pytest.mark.filterwarnings("default")

RUNS = int(os.environ.get("MOCAPD_ARCHIVE_KILLS", "1"))
"""Seeded runs with kills; the bar is 100, which takes more than an hour."""

N_FILES = 40


@pytest.fixture(scope="module")
def cluster():
    """A cluster of two cores, whose workers find the tests' modules."""
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    context = ray.init(
        num_cpus=2, include_dashboard=False, log_to_driver=False, runtime_env={"env_vars": {"PYTHONPATH": path}}
    )
    yield context.address_info["gcs_address"]
    ray.shutdown()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """40 files of which one is there twice, and one that is no C3D file."""
    folder = tmp_path_factory.mktemp("c3d")
    paths = write_c3ds(folder, N_FILES - 2, frames=60)
    (folder / "copy.c3d").write_bytes(paths[0].read_bytes())
    (folder / "bad.c3d").write_bytes(b"no C3D file" * 100)
    return folder


class FailingStore(archive.FolderStore):
    """A folder in which, at random, a put kills its process, or fails before or after its effect."""

    def __init__(self, path, seed, share):
        super().__init__(path)
        self.seed, self.share = seed, share

    def put_if_absent(self, name, data):
        # Another outcome in each attempt, of each process.
        chance = random.Random(f"{self.seed} {name} {os.getpid()} {time.monotonic_ns()}")
        fate = chance.random() / self.share
        if fate < 0.5:
            os._exit(1)
        if fate < 0.75:
            raise archive.StoreError("the store does not answer")
        created = super().put_if_absent(name, data)
        if 0.75 <= fate < 1:
            if chance.random() < 0.5:
                os._exit(1)
            raise archive.StoreError("the store did not answer in time")
        return created


DRIVER = """
import os, sys
import ray
from mocapd import archive
from test_ray import FailingStore
address, folder, bucket, seed, share, workers = sys.argv[1:]
runtime = {"env_vars": {"PYTHONPATH": os.environ["PYTHONPATH"]}}
ray.init(address=address, log_to_driver=False, logging_level="ERROR", runtime_env=runtime)
store = FailingStore(bucket, int(seed), float(share))
import mocapd.archive._ingest as module
module.COMMIT_ROWS = 7
# The driver may also end before or after the effect of a commit.
import random
import mocapd.archive._catalogue as table
write, chance = table.write_deltalake, random.Random(f"{seed} commits")
def write_or_end(*args, **options):
    fate = chance.random() / float(share) / 4
    if fate < 0.5:
        os._exit(9)
    write(*args, **options)
    if fate < 1:
        os._exit(9)
table.write_deltalake = write_or_end
archive.ingest(folder, store, batch_files=4, progress=False, workers=int(workers))
"""


def drive(cluster, folder, bucket, seed, share, kill_at=None):
    """Runs an ingest in a process of its own, and kills it when the bucket has so many objects. Returns whether it ended
    well."""
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    words = [sys.executable, "-c", DRIVER, cluster, str(folder), str(bucket), str(seed), str(share), "2"]
    with tempfile.TemporaryFile() as errors:
        driver = subprocess.Popen(words, env=environment, stdout=subprocess.DEVNULL, stderr=errors)
        while driver.poll() is None:
            if kill_at is not None and sum(1 for _ in Path(bucket).glob("takes/*/*.take")) >= kill_at:
                driver.kill()
            time.sleep(0.01)
        if driver.returncode > 0:
            errors.seek(0)
            print(errors.read().decode()[-2000:])
    return driver.returncode == 0


def check(bucket):
    """Objects = rows = distinct pairs of bytes and settings."""
    rows = archive.catalogue(bucket).arrow(["status", "key", "object", "source"]).to_pylist()
    takes = [row for row in rows if row["status"] == "take"]
    objects = [entry.name for entry in archive.open_store(bucket).list("takes/")]
    assert len(takes) == len({row["key"] for row in takes}) == len(objects) == N_FILES - 2
    assert {row["object"] for row in takes} == set(objects)
    assert sorted(row["status"] for row in rows if row["status"] != "take") == ["duplicate", "failed"]
    assert len({row["source"] for row in rows}) == len(rows) == N_FILES
    # Nothing else is left, not even files that are no objects.
    files = {path.relative_to(bucket).as_posix() for path in Path(bucket).glob("takes/**/*") if path.is_file()}
    assert files == set(objects)


@pytest.mark.parametrize("seed", range(RUNS))
def test_kills_leave_each_content_once(cluster, folder, tmp_path, seed):
    chance = random.Random(seed)
    bucket = tmp_path / "archive"
    for attempt in range(10):
        # The driver is killed when there are some objects, and again when there are more; workers and store fail, too.
        share = 0.05 if attempt < 4 else 1e-9
        kill_at = chance.randrange(8, 22) + 14 * attempt if attempt < 2 else None
        if drive(cluster, folder, bucket, 100 * seed + attempt, share, kill_at):
            break
    else:
        pytest.fail(f"seed {seed}: no run ended well")
    assert attempt >= 1, "no driver was killed"
    check(bucket)
    assert archive.verify(bucket, workers=0).is_intact
    assert archive.collect(bucket, older_than_s=0) == []


def test_ray_gives_what_this_process_gives(cluster, folder, tmp_path):
    archive.ingest(folder, tmp_path / "one", workers=0, progress=False)
    archive.ingest(folder, tmp_path / "two", batch_files=5, progress=False)
    contents = [
        {path.name: path.read_bytes() for path in (tmp_path / name).glob("takes/**/*.take")} for name in ("one", "two")
    ]
    assert contents[0] == contents[1] and len(contents[0]) == N_FILES - 2
    check(tmp_path / "two")
    assert archive.verify(tmp_path / "two").is_intact


def test_ray_data_reads_windows(cluster, folder, tmp_path):
    archive.ingest(folder, tmp_path / "archive", workers=0, progress=False)
    takes = archive.catalogue(tmp_path / "archive").sql("select object, rate_hz, frames from takes")
    windows = archive.windows(takes, 0.2, RATE_HZ, ["M0", "M2"], bucket=tmp_path / "archive", shuffle=3, batch=8)
    ray.data.DataContext.get_current().enable_progress_bars = False
    dataset = windows.ray_dataset(objects=True)
    found = list(dataset.iter_batches(batch_size=None))
    assert sum(len(batch["valid"]) for batch in found) == len(windows.places) == 3 * (N_FILES - 2)
    local = {(name, start): rows for batch in windows for name, start, rows in zip(*parts(batch))}
    remote = {(name, start): rows for batch in found for name, start, rows in zip(*parts(batch))}
    assert local.keys() == remote.keys()
    assert all(np.array_equal(local[key], remote[key]) for key in local)


def import_or_exit(self, data, format, subject):
    """An import that ends its process, as one that needs too much memory."""
    if b"EXIT" in data:
        os._exit(1)
    return archive_import(self, data, format, subject)


archive_import = archive._ingest.ImportTask._import


class ExitingTask(archive._ingest.ImportTask):
    _import = import_or_exit


def test_a_file_that_ends_its_process_is_a_row_of_its_own(cluster, tmp_path, monkeypatch):
    write_c3ds(tmp_path / "c3d", 5, frames=60)
    (tmp_path / "c3d" / "evil.c3d").write_bytes(b"EXIT" * 100)
    monkeypatch.setattr(archive._ingest, "ImportTask", ExitingTask)
    report = archive.ingest(tmp_path / "c3d", tmp_path / "archive", progress=False)
    assert (report.takes, report.failed) == (5, 1), report.errors
    assert "evil.c3d" in report.errors[0][0] and "ended the process" in report.errors[0][1]


STORE = """
from mocapd.archive import FolderStore
class ScriptStore(FolderStore):
    def put_if_absent(self, name, data):
        open("stored", "a").close()
        return super().put_if_absent(name, data)
"""


def test_workers_import_modules_of_the_script_and_none_of_the_current_folder(tmp_path):
    """They stay in that folder: names of files in the environment, such as that of a key, may be relative."""
    scripts, current = tmp_path / "scripts", tmp_path / "current"
    write_c3ds(current / "c3d", 2, frames=60)
    scripts.mkdir()
    (scripts / "script_store.py").write_text(STORE)
    (scripts / "script.py").write_text(
        "from mocapd import archive\nfrom script_store import ScriptStore\n"
        "report = archive.ingest('c3d', ScriptStore('archive'), workers=1, progress=False)\nassert report.takes == 2\n"
    )
    # The workers import both.
    for name in ("deltalake", "secrets"):
        (current / f"{name}.py").write_text(f"open({str(tmp_path / 'imported')!r}, 'a').write({name!r})")
    environment = {name: value for name, value in os.environ.items() if name != "RAY_ADDRESS"}
    words = [sys.executable, str(scripts / "script.py")]
    done = subprocess.run(words, cwd=current, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    assert (current / "stored").exists() and not (tmp_path / "imported").exists()


def parts(batch):
    return batch["object"], batch["time_s"][:, 0], batch["positions"]


def test_ray_data_gives_torch_tensors(cluster, folder, tmp_path):
    torch = pytest.importorskip("torch")
    archive.ingest(folder, tmp_path / "archive", workers=0, progress=False)
    windows = archive.windows("select * from takes", 0.2, RATE_HZ, ["M0"], bucket=tmp_path / "archive", batch=8)
    dataset = windows.ray_dataset()
    n_windows = 0
    for batch in dataset.iter_torch_batches(batch_size=8):
        assert batch["positions"].dtype == torch.float32 and batch["positions"].shape[1:] == (20, 1, 3)
        n_windows += len(batch["valid"])
    assert n_windows == len(windows.places) > 0
