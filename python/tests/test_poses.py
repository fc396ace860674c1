"""Poses of rigid bodies in a recording, against an export to NPZ."""

import subprocess

import numpy as np
import pytest
from conftest import run

import mocapd


@pytest.fixture(scope="module")
def bodies(program, tmp_path_factory):
    """A take recorded from a simulated device with eleven rigid bodies, some of whose frames were lost."""
    simulator = program.with_name("mocapd-sim")
    if not simulator.exists():
        pytest.skip("mocapd-sim is not beside mocapd")
    folder = tmp_path_factory.mktemp("bodies")
    (folder / "lost.toml").write_text('seed = 5\n[[fault]]\nkind = "lost-frames"\nrate = 0.04\n', encoding="utf-8")
    what = ["--generate", "jump", "--rate", "100Hz", "--seconds", "3s", "--bodies", "11"]
    command = [simulator, "serve", *what, "--faults", folder / "lost.toml", f"--pty={folder / 'rig'}", "--once"]
    with subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE) as served:
        assert served.stdout.readline()
        run(program, "record", "--device", f"serial:{folder / 'rig'}", "--output", folder / "jump.take")
        served.communicate(timeout=30)
    run(program, "export", folder / "jump.take", "-o", folder / "jump.npz")
    return folder


def test_poses_are_those_of_an_export(bodies):
    exported = np.load(bodies / "jump.npz")
    with mocapd.open(bodies / "jump.take") as take:
        poses = take.poses
        assert len(poses) == 11 and poses.n_frames == take.n_frames and poses.names[0] in poses
        assert list(poses.names) == exported["body_names"].tolist()
        for ours, theirs in [
            (poses.positions, "positions_mm"),
            (poses.quaternions, "quaternions"),
            (poses.residuals, "residuals_mm"),
            (poses.states, "states"),
        ]:
            assert ours.dtype == exported[f"pose_{theirs}"].dtype
            np.testing.assert_array_equal(ours, exported[f"pose_{theirs}"])
        tracked = poses.states == 0
        assert 0.5 < tracked.mean() < 1
        np.testing.assert_array_equal(np.isfinite(poses.positions).all(axis=2), tracked)
        np.testing.assert_allclose(np.linalg.norm(poses.quaternions[tracked], axis=1), 1, atol=1e-6)
        assert (poses.states == 253).all(axis=1).any(), "lost frames have no poses"
        assert set(np.unique(poses.states)) <= set(poses.STATES)


def test_a_part_is_that_of_the_whole(bodies):
    with mocapd.open(bodies / "jump.take") as take:
        poses = take.poses
        part = poses.read(1.5, 2.25, [poses.names[9], 0])
        np.testing.assert_array_equal(part.frame, np.arange(150, 225))
        np.testing.assert_allclose(part.time_s, part.frame / 100)
        for ours, whole in [
            (part.positions_mm, poses.positions),
            (part.quaternions, poses.quaternions),
            (part.residuals_mm, poses.residuals),
            (part.states, poses.states),
        ]:
            np.testing.assert_array_equal(ours, whole[150:225][:, [9, 0]])
        np.testing.assert_array_equal(poses.read(start_frame=290).states, poses.states[290:])
        assert poses.read(100.0).positions_mm.shape == (0, 11, 3)
        with pytest.raises(ValueError, match="ends before"):
            poses.read(2.0, 1.0)
        with pytest.raises(ValueError, match="not both"):
            poses.read(1.0, stop_frame=7)
        with pytest.raises(KeyError, match="no rigid body"):
            poses.read(bodies="nobody")
        with pytest.raises(KeyError, match="no body 11"):
            poses.read(bodies=11)
    with pytest.raises(ValueError):
        poses.read(0.0, 1.0)


def test_tables_of_poses(bodies):
    pytest.importorskip("pandas")
    with mocapd.open(bodies / "jump.take") as take:
        name = take.poses.names[3]
        table = take.to_pandas("poses", 0.5, 1.0, [name])
        assert table.shape == (50, 9) and table.columns[0] == (name, "x")
        np.testing.assert_array_equal(table[name][["x", "y", "z"]], take.poses.positions[50:100, 3])
        np.testing.assert_array_equal(table[name]["state"], take.poses.states[50:100, 3])
        assert table.attrs["units"]["x"] == "mm" and table.attrs["states"][1] == "lost"


def test_a_take_without_bodies_has_no_poses(path):
    with mocapd.open(path) as take:
        assert len(take.poses) == 0 and take.poses.positions.shape == (take.n_frames, 0, 3)
