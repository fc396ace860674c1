"""A recording of a simulated device, compared with the output of the command line."""

import json

import numpy as np

import mocapd
from conftest import run


def test_it_matches_info(program, recorded):
    info = json.loads(run(program, "info", "--json", recorded))
    take = mocapd.open(recorded)
    assert (take.frames, take.n_markers, take.rate_hz) == (info["frames"], info["markers"], info["rate_hz"])
    assert list(take.labels) == [channel["label"] for channel in info["channels"]]
    for found, channel in zip(take.summary.values(), info["channels"]):
        expected = [channel[name] for name in ("samples", "gaps", "knots", "max_error_mm")]
        assert [found.n_samples, found.n_gaps, found.n_knots, found.max_error_mm] == expected
    assert take.header.software == info["software"] and take.header.created is not None
    assert take.header.device.driver == info["device"]["driver"]
    assert take.ledger.closes and take.ledger.recorded == take.n_frames
    assert take.ending.kind == info["ending"] and take.ending.detail == (info["ending_detail"] or "")
    assert len(take.events) == len(info["events"])
    assert len(take.clock_lines) == len(info["clock"]["lines"])


def test_positions_match_an_export(program, recorded, tmp_path):
    run(program, "export", recorded, "-o", tmp_path / "all.csv")
    table = np.genfromtxt(tmp_path / "all.csv", delimiter=",", skip_header=1)
    take = mocapd.open(recorded)
    np.testing.assert_array_equal(take.positions.reshape(len(take), -1), table[:, 2:].astype(np.float32))
    np.testing.assert_allclose(take.times().nominal_s, table[:, 1])
    run(program, "export", recorded, "-o", tmp_path / "part.csv", "--from", "10.5s")
    part = np.genfromtxt(tmp_path / "part.csv", delimiter=",", skip_header=1)
    np.testing.assert_array_equal(take.read(10.5).reshape(len(part), -1), part[:, 2:].astype(np.float32))


def test_frames_have_both_clocks(recorded):
    take = mocapd.open(recorded)
    times = take.times()
    assert times.recorded.all() and len(times.device_s) == take.n_frames
    period_s = 1 / take.rate_hz
    assert np.abs(np.diff(times.device_s) - period_s).max() < 0.1 * period_s
    assert abs((times.host_s[-1] - times.host_s[0]) - take.duration_s) < 0.5
    some = take.times(11, 11.5)
    np.testing.assert_array_equal(some.device_ticks, times.device_ticks[some.frame])
    np.testing.assert_array_equal(some.host_s, times.host_s[some.frame])


def test_the_program_reads_takes_written_from_python(program, path, motion, tmp_path):
    info = json.loads(run(program, "info", "--json", path))
    assert (info["frames"], info["markers"], info["problems"]) == (4200, 70, [])
    assert info["ending"] is None and mocapd.open(path).ending is None
    assert info["max_error_mm"] <= 0.5 and info["ledger"]["closes"]
    run(program, "verify", path)
    run(program, "export", path, "-o", tmp_path / "t.csv")
    table = np.genfromtxt(tmp_path / "t.csv", delimiter=",", skip_header=1)[:, 2:].astype(np.float32)
    np.testing.assert_array_equal(table, mocapd.open(path).positions.reshape(4200, -1))


