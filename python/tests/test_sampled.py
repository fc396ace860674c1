"""Sampled channels and force plates of a recording, beside those of imports."""

import subprocess

import c3d_files
import numpy as np
import pytest
from conftest import run

import mocapd


@pytest.fixture(scope="module")
def jump(program, tmp_path_factory):
    """A take recorded from a simulated device with two force plates and electrodes, some of whose batches were lost."""
    simulator = program.with_name("mocapd-sim")
    if not simulator.exists():
        pytest.skip("mocapd-sim is not beside mocapd")
    folder = tmp_path_factory.mktemp("jump")
    (folder / "lost.toml").write_text('seed = 5\n[[fault]]\nkind = "lost-frames"\nrate = 0.04\n', encoding="utf-8")
    what = ["--generate", "jump", "--rate", "100Hz", "--seconds", "3s", "--plates", "--emg", "3@500Hz"]
    command = [simulator, "serve", *what, "--faults", folder / "lost.toml", f"--pty={folder / 'rig'}", "--once"]
    with subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE) as served:
        assert served.stdout.readline()
        run(program, "record", "--device", f"serial:{folder / 'rig'}", "--output", folder / "jump.take")
        served.communicate(timeout=30)
    run(program, "export", folder / "jump.take", "-o", folder / "jump.npz")
    return folder


def test_groups_have_the_values_and_times_of_an_export(jump):
    exported = np.load(jump / "jump.npz")
    with mocapd.open(jump / "jump.take") as take:
        assert [group.number for group in take.sampled] == [0, 1]
        assert [len(group) for group in take.sampled] == [12, 3]
        for group in take.sampled:
            name = f"sampled_{group.number}"
            assert group.values.dtype == np.float32 and group.time_s.dtype == np.float64
            np.testing.assert_array_equal(group.values, exported[name])
            np.testing.assert_array_equal(group.time_s, exported[f"{name}_time_s"])
            assert list(group.names) == exported[f"{name}_labels"].tolist()
            assert np.isnan(group.values).any()
        vertical = take.sampled[0]["Fz1"]
        assert vertical.unit == "N" and vertical.rate_hz == 1000
        np.testing.assert_array_equal(vertical.values, take.sampled[0].values[:, 2])
        assert len(take.analog) == 0


def test_a_part_is_that_of_the_whole(jump):
    with mocapd.open(jump / "jump.take") as take:
        group = take.sampled[0]
        part = group.read(1.5, 2.25, ["Fz1", 0])
        times = group.times(1.5, 2.25)
        wanted = (group.time_s >= 1.5) & (group.time_s < 2.25)
        np.testing.assert_array_equal(times, group.time_s[wanted])
        np.testing.assert_array_equal(part, group.values[wanted][:, [2, 0]])
        assert group.read(100.0).shape == (0, 12)
        with pytest.raises(ValueError, match="ends before"):
            group.read(2.0, 1.0)
        with pytest.raises(KeyError, match="no analog channel"):
            group["Fz3"]


def test_force_plates_of_a_recording(jump):
    exported = np.load(jump / "jump.npz")
    with mocapd.open(jump / "jump.take") as take:
        plates = take.force_plates
        assert [plate.number for plate in plates] == [1, 2]
        assert plates[0].channels[2].name == "Fz1" and plates[1].channels[2].name == "Fz2"
        for number, plate in enumerate(plates):
            np.testing.assert_allclose(plate.force_n, exported["force_plates"][:, number, 0], rtol=1e-6)
            np.testing.assert_allclose(plate.cop_mm, exported["force_plates"][:, number, 2], rtol=1e-6, atol=1e-4)
            np.testing.assert_array_equal(plate.time_s, exported["force_plates_time_s"])
            np.testing.assert_array_equal(plate.corners_mm, exported["force_plate_corners_mm"][number])
        part = plates[0].read(0.5, 1.0)
        assert (part.time_s >= 0.5).all() and (part.time_s < 1.0).all() and len(part.force_n) == len(part.time_s) > 400


def test_tables_of_a_recording(jump):
    with mocapd.open(jump / "jump.take") as take:
        frame = take.to_pandas("sampled", 1, 0.5, 1.0)
        assert list(frame.columns) == ["EMG1", "EMG2", "EMG3"] and frame.attrs["units"]["EMG1"] == "V"
        assert frame.index.name == "time_s" and frame.index[0] >= 0.5
        loads = take.to_pandas("force_plates")
        np.testing.assert_array_equal(loads[(1, "force_n", "z")], take.force_plates[0].force_n[:, 2])
        with pytest.raises(ValueError, match="give the index"):
            take.to_pandas("sampled")
        with pytest.raises(ValueError, match="no group 2"):
            take.to_pandas("sampled", 2)


def test_an_import_has_its_analog_channels_as_a_group(imported):
    points = c3d_files.walk(20)
    samples = np.arange(20 * 4 * 2, dtype=float).reshape(-1, 2)
    records = c3d_files.channel_records(2, labels=["a", "b"], units=["V", "V"], scales=[0.5, 2.0], offsets=[0, 0])
    take = imported(c3d_files.c3d_file(points, samples, 4, records))
    assert take.sampled == (take.analog,)
    np.testing.assert_array_equal(take.to_pandas("sampled"), take.to_pandas("analog"))


def test_a_take_without_sampled_channels_has_none(path):
    with mocapd.open(path) as take:
        assert take.sampled == () and take.force_plates == ()
        assert take.to_pandas("sampled").empty
