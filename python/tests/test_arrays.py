import os
import threading
import time

import numpy as np
import pytest

import mocapd
from conftest import error_mm, make_motion


@pytest.mark.parametrize("resampler", ["dense", "fast", "spline", "spline:exhaustive", "sync"])
@pytest.mark.parametrize("tolerance_mm", [0.1, 1, 20])
def test_decompressed_samples_are_within_the_tolerance(resampler, tolerance_mm):
    array = make_motion(300, 5)
    found = mocapd.decompress(mocapd.compress(array, tolerance_mm, resampler))
    assert found.dtype == np.float32 and found.shape == array.shape
    assert error_mm(found, array) <= tolerance_mm


@pytest.mark.parametrize("resampler", ["lossless", "lossless:predictive"])
def test_lossless_keeps_every_bit(motion, resampler):
    data = mocapd.compress(motion, None, resampler)
    np.testing.assert_array_equal(mocapd.decompress(data).view(np.uint32)[:, 0], motion.view(np.uint32)[:, 0])
    assert len(data) < motion.nbytes


def test_the_same_array_gives_the_same_bytes(motion):
    one = mocapd.compress(motion, 0.5, threads=1)
    assert one == mocapd.compress(motion, 0.5, threads=3) != mocapd.compress(motion, 0.6)
    assert len(one) * 10 < motion.nbytes


def test_any_layout_and_number_type():
    array = make_motion(200, 6)
    expected = mocapd.compress(array, 0.5)
    assert mocapd.compress(array.astype(np.float64), 0.5) == expected
    assert mocapd.compress(np.asfortranarray(array), 0.5) == expected
    wide = np.repeat(array, 2, axis=1)
    assert mocapd.compress(wide[:, ::2], 0.5) == expected
    assert mocapd.compress(array.astype(">f4"), 0.5) == expected
    whole = np.arange(12).reshape(2, 2, 3)
    assert error_mm(mocapd.decompress(mocapd.compress(whole, 0.5)), whole.astype(np.float32)) <= 0.5


def test_invalid_arrays_are_refused():
    array = make_motion(20, 2)
    for wrong, message in [
        (array[:, 0], r"array\[:, np.newaxis, :\]"),
        (array[:, :, :2], "frames, markers, 3"),
        (array.astype(np.complex64), "complex64"),
        (np.array([[["a"] * 3]]), "<U1"),
    ]:
        with pytest.raises(ValueError, match=message):
            mocapd.compress(wrong, 0.5)
    for value in [np.nan, np.inf, -np.inf]:
        half = np.ones((20, 2, 3), dtype=np.float32)
        half[7, 0, 1] = value
        with pytest.raises(ValueError, match="frame 7, marker 0"):
            mocapd.compress(half, 0.5)
    with pytest.raises(ValueError, match="frame 3, marker 1"):
        too_large = array.astype(np.float64)
        too_large[3, 1] = 1e39
        mocapd.compress(too_large, 0.5)


@pytest.mark.parametrize("tolerance_mm", [0, -1, None, float("nan"), 1e-9, 1e9])
def test_invalid_tolerances_are_refused(tolerance_mm):
    with pytest.raises(ValueError, match="lossless|tolerance"):
        mocapd.compress(make_motion(20, 2), tolerance_mm)


def test_an_unknown_resampler_is_named_in_the_error():
    with pytest.raises(ValueError, match="'smallest'.*dense"):
        mocapd.compress(make_motion(20, 2), 1, "smallest")


def test_damaged_bytes_are_a_take_error():
    data = mocapd.compress(make_motion(150, 4), 0.5)
    for cut in range(len(data)):
        with pytest.raises(mocapd.TakeError):
            mocapd.decompress(data[:cut])
    random = np.random.default_rng(5)
    for at in range(len(data)):
        damaged = bytearray(data)
        damaged[at] ^= int(random.integers(1, 256))
        with pytest.raises(mocapd.TakeError):
            mocapd.decompress(bytes(damaged))


def test_no_file_is_overwritten(tmp_path):
    path = tmp_path / "t.take"
    size = mocapd.write_take(path, make_motion(50, 2), ["a", "b"], 60)
    assert size == path.stat().st_size
    before = path.read_bytes()
    with pytest.raises(FileExistsError):
        mocapd.write_take(path, make_motion(50, 2), ["a", "b"], 60)
    assert path.read_bytes() == before and os.listdir(tmp_path) == ["t.take"]
    with pytest.raises(FileNotFoundError):
        mocapd.write_take(tmp_path / "none" / "t.take", make_motion(50, 2), ["a", "b"], 60)


def test_invalid_arguments_write_no_file(tmp_path):
    array = make_motion(50, 2)
    for labels, rate_hz, more, message in [
        (["a"], 60, {}, "1 labels.* 2 markers"),
        (["a", "b"], 0, {}, "0 Hz"),
        (["a", "b"], float("inf"), {}, "inf Hz"),
        (["a", "b"], 60, {"up_axis": "up"}, "'x', 'y', 'z'"),
        (["a", "b"], 60, {"tolerance_mm": 0}, "lossless"),
    ]:
        with pytest.raises(ValueError, match=message):
            mocapd.write_take(tmp_path / "t.take", array, labels, rate_hz, **more)
    assert os.listdir(tmp_path) == []


def test_other_threads_run_while_it_works():
    data = mocapd.compress(make_motion(6000, 60), 0.1)
    done = threading.Event()
    took = []

    def work():
        started = time.perf_counter()
        for _ in range(3):
            mocapd.decompress(data, threads=1)
        took.append(time.perf_counter() - started)
        done.set()

    thread = threading.Thread(target=work)
    thread.start()
    turns = 0
    while not done.wait(0.001):
        turns += 1
    thread.join()
    # With the GIL held there would be one turn for each call.
    assert turns > 20, f"{turns} turns in {took[0]:.3f} s"
