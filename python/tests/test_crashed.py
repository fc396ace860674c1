"""Takes that were cut off by a crash, and takes that were damaged on disk."""

import warnings

import numpy as np
import pytest

import mocapd


def opened(path):
    with warnings.catch_warnings(record=True) as messages:
        warnings.simplefilter("always")
        take = mocapd.open(path)
        positions = take.read()
    assert all(issubclass(warning.category, mocapd.TakeWarning) for warning in messages)
    return take, positions, [str(warning.message) for warning in messages]


def test_a_cut_take_has_all_complete_stretches(path, tmp_path):
    data = path.read_bytes()
    whole = mocapd.open(path).positions
    frames = set()
    for cut in list(range(0, len(data), len(data) // 97)) + [len(data) - 1]:
        damaged = tmp_path / "cut.take"
        damaged.write_bytes(data[:cut])
        try:
            take, positions, messages = opened(damaged)
        except mocapd.TakeError as error:
            assert cut < 2000 and str(damaged) in str(error)
            continue
        assert not take.finished and take.problems
        assert any("`mocapd recover`" in message and f"{take.n_frames} frames" in message for message in messages)
        np.testing.assert_array_equal(positions, whole[: take.n_frames])
        assert take.positions.shape == (take.n_frames, 70, 3)
        frames.add(take.n_frames)
    assert frames == {0, 1200, 2400, 3600, 4200}


def test_a_damaged_stretch_is_lost_frames_with_their_cause(path, tmp_path):
    data = bytearray(path.read_bytes())
    whole = mocapd.open(path).positions
    data[len(data) // 2] ^= 1
    damaged = tmp_path / "damaged.take"
    damaged.write_bytes(data)
    take, positions, messages = opened(damaged)
    assert take.finished and messages and take.problems
    lost = np.isnan(positions).all(axis=(1, 2))
    (damage,) = take.lost
    assert (damage.n_frames, damage.cause) == (1200, "damaged") and lost.sum() == 1200
    assert lost[damage.first_frame : damage.first_frame + 1200].all()
    np.testing.assert_array_equal(positions[~lost], whole[~lost])
    # A problem is reported once only, and intact parts are read without a warning.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        take.read()
        np.testing.assert_array_equal(mocapd.open(damaged).read(30), whole[3600:])


def test_any_bytes_are_a_take_or_a_take_error(path, tmp_path):
    data = path.read_bytes()
    random = np.random.default_rng(11)
    for _ in range(150):
        damaged = bytearray(data)
        for at in random.integers(0, len(data), int(random.integers(1, 6))):
            damaged[at] = int(random.integers(0, 256))
        (tmp_path / "damaged.take").write_bytes(damaged)
        try:
            take, positions, _ = opened(tmp_path / "damaged.take")
        except (mocapd.TakeError, ValueError) as error:
            assert str(error)
            continue
        assert positions.shape == take.shape
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            assert len(take.summary) == take.n_markers and isinstance(take.lost, tuple)


def test_a_cut_recording_has_the_positions_and_times_of_the_whole(recorded, tmp_path):
    data = recorded.read_bytes()
    whole = mocapd.open(recorded)
    for part in (0.3, 0.6, 0.9):
        (tmp_path / "cut.take").write_bytes(data[: int(len(data) * part)])
        take, positions, messages = opened(tmp_path / "cut.take")
        assert 0 < take.n_frames < whole.n_frames and len(messages) >= 1
        np.testing.assert_array_equal(positions, whole.positions[: take.n_frames])
        times = take.times()
        np.testing.assert_array_equal(times.device_ticks, whole.times().device_ticks[: take.n_frames])
        assert take.ledger is not None and not take.ledger.finished


