"""Archives in a folder, imported in this process."""

import dataclasses
import hashlib
import json
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pytest

import mocapd

archive = pytest.importorskip("mocapd.archive")

from made import RATE_HZ, c3d, limbs_c3d, motion, write_c3ds  # noqa: E402
from mocapd._native import import_motion  # noqa: E402
from mocapd.archive._keys import key_seconds, tolerance_mm  # noqa: E402

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


def chunks(take):
    """The chunks of a take that do not state the names of its source and its program, or offsets that follow from them."""
    found, at = [], 8
    while at < len(take):
        start, kind, length, shift = at, take[at], 0, 0
        while True:
            at += 1
            length |= (take[at] & 0x7F) << shift
            shift += 7
            if take[at] < 0x80:
                break
        at += 1 + length + 4
        if kind not in NAMING_CHUNKS:
            found.append((kind, take[start:at]))
    return found


HEADER, FOOTER, INDEX, SUMMARY, ORDER = 0x01, 0x8B, 0x8A, 0x8D, 0x92
NAMING_CHUNKS = HEADER, FOOTER, INDEX, SUMMARY


@pytest.mark.parametrize("effort", [1, 3, 9])
def test_it_is_what_the_command_imports(effort, program, tmp_path):
    """Byte for byte, with events, analog channels and residuals."""
    path, to = tmp_path / "walk.c3d", tmp_path / "walk.take"
    path.write_bytes(limbs_c3d())
    words = [program, "import", path, "-o", to, "--tolerance", "0.2mm", "--effort", str(effort)]
    subprocess.run(words, check=True, capture_output=True)
    imported = import_motion(path.read_bytes(), archive.Settings(0.2, effort=effort).options("c3d", None)).take
    found, wanted = chunks(imported), chunks(to.read_bytes())
    assert [kind for kind, _ in found] == [kind for kind, _ in wanted] and len(found) > 4
    assert found == wanted
    assert (ORDER in dict(found)) == (effort == 9)
    (tmp_path / "same.take").write_bytes(imported)
    one, other = mocapd.open(to), mocapd.open(tmp_path / "same.take")
    assert np.array_equal(one.positions, other.positions, equal_nan=True) and one.labels == other.labels
    assert one.summary == other.summary and one.ledger == other.ledger
    names = {"software": "", "take_id": ""}
    header, same = (dataclasses.replace(take.header, **names, source=None) for take in (one, other))
    assert header == same and one.header.source.file == "walk.c3d" and other.header.source.file == ""


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
    documents = [one.document("c3d", None) for one in settings]
    documents += [settings[0].document("trc", None), settings[0].document("c3d", "anna"), settings[0].document("take", None)]
    keys = [archive.content_key("00" * 32, document) for document in documents]
    keys += [archive.content_key("11" * 32, documents[0]), archive.content_key("00" * 32, documents[0], importer=archive.IMPORTER_VERSION + 1)]
    assert len(set(keys)) == len(keys)
    # A take is stored as it is by every importer.
    assert archive.content_key("00" * 32, documents[13], importer=archive.IMPORTER_VERSION + 1) == keys[13]


def test_equal_settings_are_written_equally():
    pairs = [
        ({"effort": 3}, {}),
        ({"unit": "MM"}, {"unit": "mm"}),
        ({"resampler": "spline"}, {"resampler": "spline:worst-sample"}),
        ({"keys_s": 2}, {"keys_s": 2.0}),
        ({"tolerance_mm": 1}, {"tolerance_mm": 1.0}),
        ({"tolerance_mm": tolerance_mm("700um")}, {"tolerance_mm": tolerance_mm("0.7mm")}),
        ({"keys_s": key_seconds("500ms")}, {"keys_s": key_seconds("0.5")}),
    ]
    for one, other in pairs:
        found = [archive.content_key("00" * 32, archive.Settings(**given).document("c3d", None)) for given in (one, other)]
        assert found[0] == found[1], (one, other)


@pytest.mark.parametrize(
    "wrong",
    [
        {"resampler": "dnse"},
        {"unit": "furlong"},
        {"up": "w"},
        {"keys": "0.01s"},
        {"keys": "often"},
        {"analog_tolerance": ("x",)},
        {"tolerance": 1e9},
        {"tolerance": "5 apples"},
        {"tolerance": 0},
        {"effort": 10},
        {"resampler": "fast", "effort": 2},
        {"resampler": "spline", "keys": "1s"},
        {"drop_foreign": True, "analog_tolerance": ("0.1%",)},
    ],
)
def test_wrong_settings_are_refused_before_a_file_is_read(wrong, tmp_path):
    write_c3ds(tmp_path / "c3d", 1)
    with pytest.raises(ValueError):
        archive.ingest(tmp_path / "c3d", tmp_path / "archive", workers=0, progress=False, **wrong)
    assert not (tmp_path / "archive").exists()


def test_the_bytes_of_an_import_belong_to_the_version_of_the_importer():
    """If this fails, the importer gives other bytes: raise IMPORTER_VERSION, and state the new hashes."""
    found = {}
    for number, (name, options) in enumerate(IMPORTS.items()):
        settings = archive.Settings(**options)
        data = limbs_c3d() if number % 2 else c3d(1)
        found[name] = hashlib.sha256(import_motion(data, settings.options("c3d", "anna")).take).hexdigest()[:16]
    assert (archive.IMPORTER_VERSION, found) == (2, EXPECTED)


IMPORTS = {
    "dense": {},
    "dense, all parts": {"effort": 3},
    "fast": {"resampler": "fast"},
    "effort 1, all parts": {"effort": 1},
    "lossless:predictive": {"resampler": "lossless:predictive"},
    "effort 9, all parts": {"effort": 9, "tolerance_mm": 0.2},
    "lossless": {"resampler": "lossless"},
    "keys, unit, axis, analog tolerance": {"keys_s": 0.5, "unit": "cm", "up": "-z", "analog_tolerance": ("1%",)},
}
EXPECTED = {
    "dense": "edfffd1cb13e71b7",
    "dense, all parts": "dbee91ea1d9e213e",
    "fast": "bad8e0c75b942c07",
    "effort 1, all parts": "302d0b5b2e367781",
    "lossless:predictive": "e0e65bbce808f13d",
    "effort 9, all parts": "0aa959e6b4da1d05",
    "lossless": "e4ccbc5cd2c3deb1",
    "keys, unit, axis, analog tolerance": "bc4b4f973a6df72e",
}


@pytest.mark.parametrize("format", ["trc", "tsv", "csv"])
def test_text_files_are_imported(format, folder, program, tmp_path):
    """What the command exports of a take is a source, and gives the positions of the take within both tolerances."""
    take, path = tmp_path / "a.take", tmp_path / "c3d" / f"a name.{format}"
    path.parent.mkdir()
    path.with_suffix(".c3d").write_bytes(limbs_c3d())
    for words in (["import", path.with_suffix(".c3d"), "-o", take], ["export", take, "-o", path]):
        subprocess.run([program, *words], check=True, capture_output=True)
    report = archive.ingest(path, tmp_path / "archive", tolerance=0.1, workers=0, progress=False)
    assert (report.takes, report.failed) == (1, 0), report.errors
    (row,) = archive.catalogue(tmp_path / "archive").arrow().to_pylist()
    assert (row["format"], row["frames"], row["markers"]) == (format, 150, 12) and row["source"].endswith(f"/a name.{format}")
    found, wanted = mocapd.open(tmp_path / "archive" / row["object"]), mocapd.open(take)
    assert np.allclose(found.positions, wanted.positions, atol=0.12, equal_nan=True)


# The version of an importer that was changed once more.
NEXT_IMPORTER = archive.IMPORTER_VERSION + 1


def test_another_version_of_the_importer_adds_takes(tmp_path, monkeypatch):
    """After a fix of the importer both takes of a source are listed, until the old rows are retired: those of sources that
    were imported again."""
    import mocapd.archive._ingest as module

    copy = tmp_path / "archive"
    paths = write_c3ds(tmp_path / "c3d", 3)
    (tmp_path / "c3d" / "other.c3d").write_bytes(paths[2].read_bytes())
    mocapd.write_take(tmp_path / "c3d" / "rig.take", motion(9), LABELS, RATE_HZ, 0.5)
    report = archive.ingest(tmp_path / "c3d", copy, workers=0, progress=False)
    assert (report.takes, report.duplicates) == (4, 1)
    catalogue = archive.catalogue(copy)
    assert catalogue.retire(NEXT_IMPORTER) == 0 and len(objects(copy)) == 4
    new_row = module.new_row
    monkeypatch.setattr(module, "content_key", lambda *args: archive.content_key(*args, importer=NEXT_IMPORTER))
    monkeypatch.setattr(module, "new_row", lambda *args, **fields: new_row(*args, **fields | {"importer": NEXT_IMPORTER}))
    # One source is gone, and one of two with the same bytes; the take is as it is by every importer.
    paths[0].unlink()
    paths[2].unlink()
    report = archive.ingest(tmp_path / "c3d", copy, workers=0, progress=False)
    assert (report.takes, report.unchanged) == (2, 1) and len(objects(copy)) == 6
    rows = catalogue.sql(f"select source from latest where importer = {NEXT_IMPORTER}").column("source").to_pylist()
    assert sorted(name.rpartition("/")[2] for name in rows) == ["other.c3d", "walk0001.c3d"]
    assert catalogue.retire(NEXT_IMPORTER) == 1
    assert archive.collect(copy) == []  # too young
    assert len(archive.collect(copy, older_than_s=0, remove=True)) == 1
    assert len(objects(copy)) == 5 and archive.verify(copy, workers=0).is_intact
    assert archive.catalogue(copy, version=2).arrow().num_rows == 7


def test_retired_takes_were_made_again_from_the_same_bytes_with_the_same_settings(tmp_path, monkeypatch):
    import mocapd.archive._ingest as module

    bucket, (path,) = tmp_path / "archive", write_c3ds(tmp_path / "c3d", 1)
    for tolerance in (0.5, 2.0):
        archive.ingest(path, bucket, tolerance=tolerance, workers=0, progress=False)
    first_bytes = path.read_bytes()
    path.write_bytes(c3d(77))
    archive.ingest(path, bucket, workers=0, progress=False)
    new_row = module.new_row
    monkeypatch.setattr(module, "content_key", lambda *args: archive.content_key(*args, importer=NEXT_IMPORTER))
    monkeypatch.setattr(module, "new_row", lambda *args, **fields: new_row(*args, **fields | {"importer": NEXT_IMPORTER}))
    archive.ingest(path, bucket, workers=0, progress=False)
    catalogue = archive.catalogue(bucket)
    assert catalogue.retire(NEXT_IMPORTER) == 1
    left = catalogue.sql("select source_sha256, tolerance_mm, importer from takes").to_pylist()
    first, second = (hashlib.sha256(data).hexdigest() for data in (first_bytes, path.read_bytes()))
    importer = archive.IMPORTER_VERSION
    assert sorted(tuple(row.values()) for row in left) == sorted([(first, 0.5, importer), (first, 2.0, importer), (second, 0.5, NEXT_IMPORTER)])


def test_the_latest_take_of_a_file_may_be_listed_under_another_name(tmp_path):
    """A file that was cut off is replaced by one whose bytes the archive has already."""
    bucket, (path, other) = tmp_path / "archive", write_c3ds(tmp_path / "c3d", 2)
    archive.ingest(tmp_path / "c3d", bucket, workers=0, progress=False)
    path.write_bytes(other.read_bytes())
    report = archive.ingest(tmp_path / "c3d", bucket, workers=0, progress=False)
    assert (report.takes, report.duplicates) == (0, 1)
    (row,) = archive.catalogue(bucket).sql("select source from latest").to_pylist()
    assert row["source"].endswith(other.name)


def test_nothing_is_removed_while_an_ingest_holds_a_lease(tmp_path):
    from mocapd.archive._lease import writing
    from mocapd.archive._store import StoreError, open_store

    bucket = tmp_path / "archive"
    archive.ingest(write_c3ds(tmp_path / "c3d", 2), bucket, workers=0, progress=False)
    archive.catalogue(bucket).delete("source like '%walk0000%'")
    with writing(open_store(bucket)):
        for older_than_s in (0, 600, 86400):
            with pytest.raises(StoreError, match="--ignore-leases"):
                archive.collect(bucket, remove=True, older_than_s=older_than_s)
        assert len(objects(bucket)) == 2
        assert len(archive.collect(bucket, remove=True, older_than_s=0, ignore_leases=True)) == 1
    assert len(objects(bucket)) == 1


def test_collect_after_former_versions_were_vacuumed(tmp_path):
    bucket = tmp_path / "archive"
    archive.ingest(write_c3ds(tmp_path / "c3d", 3), bucket, workers=0, progress=False)
    table = archive.catalogue(bucket)
    table.delete("source like '%walk0000%'")
    assert archive.collect(bucket, older_than_s=60) == []  # named a moment ago, and young
    table.delta().vacuum(0, dry_run=False, enforce_retention_duration=False)
    assert archive.collect(bucket, older_than_s=60) == []
    assert len(archive.collect(bucket, remove=True, older_than_s=0)) == 1
    assert archive.verify(bucket, workers=0).is_intact


def test_takes_are_stored_as_they_are(tmp_path):
    points = motion(5)
    mocapd.write_take(tmp_path / "a.take", points, LABELS, RATE_HZ, 0.5)
    report = archive.ingest(tmp_path / "a.take", tmp_path / "archive", workers=0, progress=False)
    assert report.takes == 1
    (row,) = archive.catalogue(tmp_path / "archive").arrow().to_pylist()
    stored = (tmp_path / "archive" / row["object"]).read_bytes()
    assert stored == (tmp_path / "a.take").read_bytes()
    assert (row["samples"], row["gaps"], row["format"]) == (470, 1, "take")
    assert row["take_sha256"] == row["source_sha256"] == hashlib.sha256(stored).hexdigest()
    assert row["max_error_mm"] <= 0.5
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
    assert store.put_if_absent("takes/ab/x.take", b"one") and not store.put_if_absent("takes/ab/x.take", b"one")
    with pytest.raises(FileExistsError):
        store.put_if_absent("takes/ab/x.take", b"two")
    assert store.get("takes/ab/x.take") == b"one"
    assert store.size("takes/ab/x.take") == 3 and store.size("takes/ab/y.take") is None
    assert [entry.name for entry in store.list()] == ["takes/ab/x.take"]
    for name in ("", "../x", "a//b", "a/./b"):
        with pytest.raises(ValueError):
            store.put_if_absent(name, b"")
    store.remove("takes/ab/x.take")
    assert list(store.list("takes/")) == []


def test_repack_of_takes_in_another_order_of_markers(tmp_path):
    """Of effort 9, and windows of them."""
    bucket, folder = tmp_path / "archive", tmp_path / "c3d"
    folder.mkdir()
    (folder / "a.c3d").write_bytes(limbs_c3d())
    archive.ingest(folder, bucket, tolerance=0.2, effort=9, workers=0, progress=False)
    (row,) = archive.catalogue(bucket).arrow().to_pylist()
    assert ORDER in dict(chunks((bucket / row["object"]).read_bytes()))
    points = mocapd.open(bucket / row["object"]).positions
    assert archive.verify(bucket, workers=0).is_intact
    report = archive.repack(bucket, workers=0)
    assert not report.failed and report.bytes_after <= report.bytes_before
    (row,) = archive.catalogue(bucket).arrow().to_pylist()
    assert np.array_equal(mocapd.open(bucket / row["object"]).positions, points, equal_nan=True)
    windows = archive.windows("select * from takes", 1.0, 60.0, ["M7", "M1"], bucket=bucket)
    (batch,) = windows
    assert np.array_equal(batch["positions"], points[:120, [7, 1]].reshape(2, 60, 2, 3))
    assert [marker["gaps"] for marker in row["motion"]] == [int(column == 5) for column in range(12)]


def test_wrong_sources_are_refused(tmp_path):
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
    _, _, section = page.partition("| column | content |")
    documented = re.findall(r"^\| `(\w+)` \|", section.split("\n## ")[0], re.MULTILINE)
    assert documented == archive.SCHEMA.names
    assert isinstance(archive.SCHEMA, pa.Schema)
