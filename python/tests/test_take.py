import uuid
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import mocapd
from conftest import RATE_HZ, error_mm


@pytest.fixture
def take(path):
    return mocapd.open(path)


def test_header_and_properties(take, motion, labels):
    assert (take.n_frames, take.frames, len(take)) == (4200, 4200, 4200)
    assert (take.n_markers, take.rate_hz, take.duration_s) == (70, RATE_HZ, 35.0)
    assert take.labels == tuple(labels) and take.shape == motion.shape
    assert take.finished and take.problems == []
    assert "70 markers" in repr(take) and "within 0.5 mm" in repr(take)
    header = take.header
    assert (header.resampler, header.tolerance_mm, header.up_axis) == ("dense", 0.5, "z")
    assert header.software.startswith("mocapd-python ") and isinstance(header.take_id, uuid.UUID)
    assert header.created is None and header.device is None
    assert (header.source.format, header.source.unit, header.source.factor_to_mm) == ("array", "mm", 1.0)
    assert take.events == () and take.clock_lines == () and take.lost == ()


def test_positions_are_within_the_tolerance(take, motion):
    assert take.positions.dtype == np.float32 and take.positions.shape == motion.shape
    assert 0.1 < error_mm(take.positions, motion) <= 0.5
    assert take.positions is take.positions


def test_the_ledger_counts_frames_and_samples(take, motion):
    present = int(np.isfinite(motion[:, :, 0]).sum())
    assert take.ledger.closes and take.ledger.finished
    assert (take.ledger.recorded, take.ledger.samples_present) == (4200, present)
    assert take.ledger.samples_occluded == 4200 * 70 - present


def test_a_part_equals_that_part_of_the_whole(take, path):
    whole = mocapd.open(path, threads=1).read()
    random = np.random.default_rng(1)
    for _ in range(60):
        start, stop = sorted(int(frame) for frame in random.integers(0, 4201, 2))
        columns = [int(column) for column in random.choice(70, int(random.integers(1, 71)), replace=False)]
        part = take.read(start_frame=start, stop_frame=stop, markers=columns)
        np.testing.assert_array_equal(part, whole[start:stop][:, columns])


def test_cached_markers_equal_those_of_the_file(take, path):
    """Markers read from the cache of decoded rows equal those decoded from the file."""
    whole = mocapd.open(path, threads=1).read()
    random = np.random.default_rng(2)
    for _ in range(12):
        start, stop = sorted(int(frame) for frame in random.integers(0, 4201, 2))
        for column in random.integers(0, 70, 6):
            # The same frames, or some of them.
            first, last = sorted(int(frame) for frame in random.integers(start, stop + 1, 2))
            for a, b in ((start, stop), (first, last)):
                part = take.read(start_frame=a, stop_frame=b, markers=[int(column)])
                np.testing.assert_array_equal(part[:, 0], whole[a:b, column])


def test_several_threads_can_read_at_once(take, path):
    whole = mocapd.open(path, threads=1).read()

    def read(column):
        return [take.read(start_frame=first, stop_frame=first + 900, markers=[column]) for first in (0, 1200, 3000)]

    with ThreadPoolExecutor(8) as pool:
        for column, parts in zip(range(70), pool.map(read, range(70))):
            for first, part in zip((0, 1200, 3000), parts):
                np.testing.assert_array_equal(part[:, 0], whole[first : first + 900, column])


def test_times_select_frames_at_or_after_them(take):
    whole = take.positions
    other = mocapd.open(take.path)
    for start_s, stop_s, frames in [
        (0.07, 0.07 + 1 / 120, slice(9, 10)),
        (1, 2, slice(120, 240)),
        (1.0001, 2.0001, slice(121, 241)),
        (34.9, None, slice(4188, None)),
        (None, 0.5, slice(0, 60)),
        (3, 3, slice(0, 0)),
        (1e9, None, slice(0, 0)),
    ]:
        np.testing.assert_array_equal(other.read(start_s, stop_s), whole[frames])


def test_indexing_by_markers_frames_or_both(take):
    whole = mocapd.open(take.path).positions
    np.testing.assert_array_equal(take[100:200], whole[100:200])
    np.testing.assert_array_equal(take[-50:], whole[-50:])
    np.testing.assert_array_equal(take[100:200:7], whole[100:200:7])
    np.testing.assert_array_equal(take[100:200, "M07"], whole[100:200, 7])
    np.testing.assert_array_equal(take[100:200, ["M69", "M01"]], whole[100:200, [69, 1]])
    marker = take["M66"]
    assert (marker.label, marker.column) == ("M66", 66) and "M66" in repr(marker)
    np.testing.assert_array_equal(marker.positions, whole[:, 66])
    np.testing.assert_array_equal(marker.read(2, 3), whole[240:360, 66])
    np.testing.assert_array_equal(marker[5:9], whole[5:9, 66])
    assert [found.label for found in take] == list(take.labels) and "M66" in take


def test_knots_are_frames_with_samples(take, motion):
    for label in ["M00", "M33", "M66"]:
        marker = take[label]
        assert marker.n_knots == len(marker.knots) == take.summary[label].n_knots
        assert 0 < marker.n_knots < 4200 / 2
        assert np.all(np.diff(marker.knots) > 0)
        assert np.isfinite(motion[marker.knots, marker.column]).all()
        np.testing.assert_allclose(marker.knot_times_s, marker.knots / RATE_HZ)
        assert 0 < marker.max_error_mm <= 0.5
    assert take["M69"].n_knots == 0 and take["M69"].max_error_mm == 0
    assert [len(knots) for knots in take.knots(["M33", 0])] == [take["M33"].n_knots, take["M00"].n_knots]


def test_the_summary_counts_samples_and_gaps(take, motion):
    for column, (label, found) in enumerate(take.summary.items()):
        present = np.isfinite(motion[:, column, 0])
        runs = np.diff(np.concatenate([[True], present]).astype(int)) == -1
        assert (found.label, found.n_samples, found.n_gaps) == (label, present.sum(), runs.sum())


def test_the_number_of_threads_changes_nothing(path):
    whole = [mocapd.open(path, threads=threads) for threads in (1, 2, 5)]
    for take in whole[1:]:
        np.testing.assert_array_equal(take.read(), whole[0].read())
        assert take.summary == whole[0].summary
        for one, other in zip(take.knots(), whole[0].knots()):
            np.testing.assert_array_equal(one, other)


def test_an_unknown_marker_is_a_key_error(take):
    for key in ["nobody", 70, -1]:
        with pytest.raises(KeyError, match=str(key)):
            take.marker(key)
    with pytest.raises(KeyError, match="nobody"):
        take.read(markers=["M01", "nobody"])


def test_invalid_arguments_are_refused(take):
    reasons = set()
    for wrong, fact in [
        (lambda: take.read(-1), "-1"),
        (lambda: take.read(float("nan")), "nan"),
        (lambda: take.read(1, start_frame=3), None),
        (lambda: take[::-1], None),
        (lambda: mocapd.open(take.path, threads=0), "0"),
    ]:
        with pytest.raises(ValueError, match=fact) as refused:
            wrong()
        reasons.add(str(refused.value))
    assert len(reasons) == 5, reasons
    with pytest.raises(TypeError, match=r"take\[5:6\]"):
        take[5]


def test_markers_with_the_same_label_are_distinguished_by_column(tmp_path, motion):
    mocapd.write_take(tmp_path / "t.take", motion[:50, :3], ["A", "A", ""], RATE_HZ)
    take = mocapd.open(tmp_path / "t.take")
    assert take.labels == ("A", "A", "u003") and list(take.summary) == ["A", "A#1", "u003"]
    with pytest.raises(KeyError, match=r"'A'.*\[0, 1\]"):
        take["A"]
    assert error_mm(take.marker(1).positions, motion[:50, 1]) <= 0.5


def test_files_that_are_not_takes(tmp_path):
    with pytest.raises(FileNotFoundError) as missing:
        mocapd.open(tmp_path / "none.take")
    assert missing.value.filename == str(tmp_path / "none.take")
    with pytest.raises(IsADirectoryError):
        mocapd.open(tmp_path)
    for content in [b"", b"\x89TAK", b"hello, world", b"\x89TAK\n\x1a\n" + bytes(90)]:
        (tmp_path / "other").write_bytes(content)
        with pytest.raises(mocapd.TakeError):
            mocapd.open(tmp_path / "other")


def test_a_take_without_frames_or_markers(tmp_path):
    for number, shape in enumerate([(0, 3, 3), (5, 0, 3), (0, 0, 3)]):
        path = Path(tmp_path / f"{number}.take")
        mocapd.write_take(path, np.zeros(shape), ["x"] * shape[1], 60)
        take = mocapd.open(path)
        assert take.positions.shape == shape and len(take.summary) == shape[1]
        assert take.times().frame.shape == (shape[0],)
