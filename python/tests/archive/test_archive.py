"""Archives in a folder, imported in this process."""

import hashlib
import json
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pytest

import mocapd

archive = pytest.importorskip("mocapd.archive")

from made import RATE_HZ, c3d, motion, write_c3ds  # noqa: E402
from mocapd._native import import_motion  # noqa: E402

LABELS = ["M0", "M1", "M2", "M3"]
NAMES = r"/(?P<subject>s\d)/(?P<session>day\d)/"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """12 files, one of them twice under another name, and one that is no C3D file."""
    folder = tmp_path_factory.mktemp("c3d")
    paths = write_c3ds(folder, 12)
    (folder / "s0" / "day0" / "copy.c3d").write_bytes(paths[0].read_bytes())
    (folder / "bad.c3d").write_bytes(b"this is no C3D file" * 100)
    (folder / "notes.txt").write_text("not a motion file")
    return folder


@pytest.fixture(scope="module")
def bucket(folder, tmp_path_factory):
    bucket = tmp_path_factory.mktemp("archive")
    report = archive.ingest(folder, bucket, tolerance="0.2mm", names=NAMES, workers=0, progress=False)
    assert (report.files, report.takes, report.duplicates, report.failed, report.unchanged) == (14, 12, 1, 1, 0)
    return bucket


def objects(bucket):
    return {entry.name for entry in archive.open_store(bucket).list("takes/")}


def test_each_source_has_a_row_and_each_content_an_object(bucket, folder):
    rows = archive.catalogue(bucket).arrow().to_pylist()
    assert len(rows) == 14
    takes = [row for row in rows if row["status"] == "take"]
    assert {row["object"] for row in takes} == objects(bucket)
    assert len(takes) == len(objects(bucket)) == 12
    (bad,) = [row for row in rows if row["status"] == "failed"]
    assert bad["source"].endswith("/bad.c3d") and "c3d" in bad["error"] and bad["object"] is None
    (copy,) = [row for row in rows if row["status"] == "duplicate"]
    (same,) = [row for row in takes if row["key"] == copy["key"]]
    assert {copy["source"].rpartition("/")[2], same["source"].rpartition("/")[2]} == {"copy.c3d", "walk0000.c3d"}


def test_a_row_describes_its_take(bucket, folder):
    catalogue = archive.catalogue(bucket)
    (row,) = catalogue.sql("select * from takes where source like '%/walk0004.c3d'").to_pylist()
    data = (folder / "s1" / "day0" / "walk0004.c3d").read_bytes()
    assert row["source_sha256"] == hashlib.sha256(data).hexdigest()
    assert (row["subject"], row["session"]) == ("s1", "day0")
    assert row["labels"] == LABELS and row["markers"] == 4
    assert (row["rate_hz"], row["frames"], row["seconds"]) == (RATE_HZ, 120, 1.2)
    assert (row["tolerance_mm"], row["resampler"], row["unit"]) == (0.2, "dense", "mm")
    assert 0 < row["max_error_mm"] <= 0.2
    points = motion(4)
    assert (row["samples"], row["gaps"]) == (4 * 120 - 10, 1)
    assert np.allclose(row["low_mm"], np.nanmin(points, axis=(0, 1)))
    assert np.allclose(row["high_mm"], np.nanmax(points, axis=(0, 1)))
    speeds = np.linalg.norm(np.diff(points.astype(float), axis=0), axis=2) * RATE_HZ
    assert np.allclose([marker["peak_speed_mm_per_s"] for marker in row["motion"]], np.nanmax(speeds, axis=0))
    assert [marker["gaps"] for marker in row["motion"]] == [0, 1, 0, 0]
    assert row["ledger"]["recorded"] == 120 and row["ledger"]["closes"]
    take = mocapd.open(bucket / row["object"])
    assert take.n_frames == 120 and bucket.joinpath(row["object"]).stat().st_size == row["take_bytes"]
    found = np.linalg.norm(take.positions - points, axis=2)
    assert np.nanmax(found) <= 0.2 + 1e-6
    assert np.isclose(row["max_error_mm"], np.nanmax(found), atol=1e-4)
    assert take.header.source.file == "" and take.subject.name == "s1"
    assert [summary.n_gaps for summary in take.summary.values()] == [0, 1, 0, 0]


def test_it_is_what_the_command_imports(bucket, folder, program, tmp_path):
    """Besides the name of the source and the software, which are no content, and the id, which depends on them."""
    path = folder / "s1" / "day0" / "walk0004.c3d"
    to = tmp_path / "a.take"
    subprocess.run([program, "import", path, "-o", to, "--tolerance", "0.2mm"], check=True, capture_output=True)
    (row,) = archive.catalogue(bucket).sql("select object from takes where source like '%walk0004.c3d'").to_pylist()
    one, other = mocapd.open(to), mocapd.open(bucket / row["object"])
    assert np.array_equal(one.positions, other.positions, equal_nan=True)


def test_a_second_ingest_changes_nothing(bucket, folder):
    before = objects(bucket)
    report = archive.ingest(folder, bucket, tolerance="0.2mm", names=NAMES, workers=0, progress=False)
    assert (report.unchanged, report.takes, report.duplicates, report.failed) == (14, 0, 0, 0)
    assert objects(bucket) == before
    assert archive.catalogue(bucket).arrow().num_rows == 14


def test_every_setting_is_in_the_key():
    settings = [
        archive.Settings(),
        archive.Settings(tolerance_mm=0.4),
        archive.Settings(resampler="fast"),
        archive.Settings(resampler="lossless:predictive"),
        archive.Settings(effort=1),
        archive.Settings(keys_s=1.0),
        archive.Settings(keys_s=float("inf")),
        archive.Settings(unit="cm"),
        archive.Settings(up="y"),
        archive.Settings(analog_tolerance=("0.1%",)),
        archive.Settings(drop_foreign=True),
    ]
    texts = [one.text("c3d", None) for one in settings]
    texts += [settings[0].text("trc", None), settings[0].text("c3d", "anna"), settings[0].text("take", None)]
    keys = [archive.content_key("00" * 32, text) for text in texts]
    keys += [archive.content_key("11" * 32, texts[0]), archive.content_key("00" * 32, texts[0], importer=2)]
    assert len(set(keys)) == len(keys)
    assert archive.Settings(effort=3) == archive.Settings()


def test_the_bytes_of_an_import_belong_to_the_version_of_the_importer():
    """If this fails, the importer gives other bytes: raise IMPORTER_VERSION, and state the new hashes."""
    found = {}
    for resampler in ("dense", "fast", "lossless:predictive"):
        options = archive.Settings(resampler=resampler).options("c3d", "anna")
        found[resampler] = hashlib.sha256(import_motion(c3d(1), options).take).hexdigest()[:16]
    expected = {"dense": "0dc477897193b3b9", "fast": "40a0a3b6abd9b146", "lossless:predictive": "babf6c2327487c56"}
    assert (archive.IMPORTER_VERSION, found) == (1, expected)


def test_another_version_of_the_importer_adds_takes(bucket, folder, tmp_path, monkeypatch):
    """After a fix of the importer both takes of a source are listed, until the old rows are deleted."""
    import mocapd.archive._ingest as module

    copy = tmp_path / "archive"
    write_c3ds(tmp_path / "c3d", 3)
    archive.ingest(tmp_path / "c3d", copy, workers=0, progress=False)
    monkeypatch.setattr(module, "content_key", lambda *args: archive.content_key(*args, importer=2))
    report = archive.ingest(tmp_path / "c3d", copy, workers=0, progress=False)
    assert report.takes == 3 and len(objects(copy)) == 6
    catalogue = archive.catalogue(copy)
    first = catalogue.sql("select min(ingested) as t, count(*) as n from takes group by source").to_pylist()
    assert [row["n"] for row in first] == [2, 2, 2]
    old = catalogue.sql("select key from takes order by ingested limit 3").column("key").to_pylist()
    assert catalogue.delete(f"key in ({', '.join(repr(key) for key in old)})") == 3
    assert archive.collect(copy) == []  # too young
    assert len(archive.collect(copy, older_than_s=0, remove=True)) == 3
    assert len(objects(copy)) == 3 and archive.verify(copy, workers=0).is_intact
    assert archive.catalogue(copy, version=1).arrow().num_rows == 6


def test_takes_are_stored_as_they_are(tmp_path):
    points = motion(5)
    mocapd.write_take(tmp_path / "a.take", points, LABELS, RATE_HZ, 0.5)
    report = archive.ingest(tmp_path / "a.take", tmp_path / "archive", workers=0, progress=False)
    assert report.takes == 1
    (row,) = archive.catalogue(tmp_path / "archive").arrow().to_pylist()
    stored = (tmp_path / "archive" / row["object"]).read_bytes()
    assert stored == (tmp_path / "a.take").read_bytes()
    assert (row["samples"], row["gaps"], row["format"]) == (470, 1, "take")
    decoded = mocapd.decompress(stored)
    assert np.allclose(row["high_mm"], np.nanmax(decoded, axis=(0, 1)))
    (tmp_path / "cut.take").write_bytes(stored[:-200])
    report = archive.ingest(tmp_path / "cut.take", tmp_path / "archive", workers=0, progress=False)
    assert report.failed == 1 and "recover" in report.errors[0][1]


def test_verify_finds_what_is_damaged_missing_and_not_listed(tmp_path):
    write_c3ds(tmp_path / "c3d", 6)
    bucket = tmp_path / "archive"
    archive.ingest(tmp_path / "c3d", bucket, workers=0, progress=False)
    assert archive.verify(bucket, workers=0).is_intact
    names = sorted(objects(bucket))
    data = bytearray((bucket / names[0]).read_bytes())
    data[len(data) // 2] ^= 1
    (bucket / names[0]).write_bytes(data)
    (bucket / names[1]).unlink()
    extra = f"takes/ab/ab{'0' * 62}.take"
    (bucket / extra).parent.mkdir(exist_ok=True)
    (bucket / extra).write_bytes((bucket / names[2]).read_bytes())
    report = archive.verify(bucket, workers=0)
    assert [name for name, _ in report.damaged] == [names[0]]
    assert report.missing == [names[1]] and report.unlisted == [extra]
    assert [entry.name for entry in archive.collect(bucket, older_than_s=0)] == [extra]
    assert extra in objects(bucket)
    archive.collect(bucket, older_than_s=0, remove=True)
    assert extra not in objects(bucket)


def test_repack_makes_takes_smaller_and_keeps_their_rows(tmp_path):
    write_c3ds(tmp_path / "c3d", 3, frames=400)
    bucket = tmp_path / "archive"
    ingest = {"tolerance": None, "resampler": "lossless", "workers": 0, "progress": False}
    archive.ingest(tmp_path / "c3d", bucket, **ingest)
    before = {row["key"]: row for row in archive.catalogue(bucket).arrow().to_pylist()}
    report = archive.repack(bucket, workers=0)
    assert report.repacked == 3 and report.bytes_after < report.bytes_before and not report.failed
    after = {row["key"]: row for row in archive.catalogue(bucket).arrow().to_pylist()}
    assert after.keys() == before.keys()
    for key, row in after.items():
        assert row["object"] != before[key]["object"] and row["take_bytes"] < before[key]["take_bytes"]
        one, other = (mocapd.open(bucket / rows[key]["object"]) for rows in (before, after))
        assert np.array_equal(one.positions, other.positions, equal_nan=True)
    assert archive.ingest(tmp_path / "c3d", bucket, **ingest).unchanged == 3
    collected = archive.collect(bucket, older_than_s=0, remove=True)
    assert {entry.name for entry in collected} == {row["object"] for row in before.values()}
    assert archive.verify(bucket, workers=0).is_intact


def test_an_object_is_never_replaced(tmp_path):
    store = archive.FolderStore(tmp_path)
    assert store.put_if_absent("takes/ab/x.take", b"one") and not store.put_if_absent("takes/ab/x.take", b"two")
    assert store.get("takes/ab/x.take") == b"one" and store.get_range("takes/ab/x.take", 1, 3) == b"ne"
    assert store.size("takes/ab/x.take") == 3 and store.size("takes/ab/y.take") is None
    assert [entry.name for entry in store.list()] == ["takes/ab/x.take"]
    for name in ("", "../x", "a//b", "a/./b"):
        with pytest.raises(ValueError):
            store.put_if_absent(name, b"")
    store.remove("takes/ab/x.take")
    assert list(store.list("takes/")) == []


def test_wrong_settings_and_sources_are_refused(tmp_path):
    for options in ({"tolerance": "5 apples"}, {"tolerance": 0}, {"effort": 10}, {"resampler": "fast", "effort": 2}):
        with pytest.raises(ValueError):
            archive.ingest(tmp_path, tmp_path / "archive", workers=0, **options)
    with pytest.raises(FileNotFoundError):
        archive.ingest(tmp_path / "nothing", tmp_path / "archive", workers=0)
    with pytest.raises(ValueError, match="subject"):
        archive.ingest(tmp_path, tmp_path / "archive", names="(?P<who>.*)", workers=0)
    for work in (archive.verify, archive.collect, archive.repack, lambda bucket: archive.catalogue(bucket).sql("select 1")):
        with pytest.raises(FileNotFoundError, match="check the name"):
            work(tmp_path / "archiv")
    with pytest.raises(ValueError, match="MOCAPD_ARCHIVE"):
        archive.catalogue()


def test_the_command_line(tmp_path):
    write_c3ds(tmp_path / "c3d", 2)

    def run(*words, code=0):
        done = subprocess.run(
            [sys.executable, "-m", "mocapd.archive", *words], capture_output=True, text=True, cwd=tmp_path, timeout=120
        )
        assert done.returncode == code, done.stderr
        return done

    done = run("ingest", "-b", "archive", "c3d", "--workers", "0", "--json")
    assert json.loads(done.stdout)["takes"] == 2
    done = run("sql", "-b", "archive", "select count(*) as n, sum(frames) as frames from takes")
    assert done.stdout == '"n","frames"\n2,240\n'
    assert run("verify", "-b", "archive", "--workers", "0").stdout.startswith("2 takes of")
    assert "no field" in run("sql", "-b", "archive", "select nothing from takes", code=2).stderr.lower()
    assert run("collect", "-b", "archive").stdout == ""
    assert "expected a length" in run("ingest", "-b", "archive", "c3d", "--tolerance", "wide", code=2).stderr


def test_the_schema_is_documented():
    import re
    from pathlib import Path

    page = (Path(__file__).parents[3] / "docs" / "archive.md").read_text()
    _, _, section = page.partition("## The catalogue")
    documented = re.findall(r"^\| `(\w+)` \|", section.split("\n## ")[0], re.MULTILINE)
    assert documented == archive.SCHEMA.names
    assert isinstance(archive.SCHEMA, pa.Schema)
