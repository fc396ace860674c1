"""Records generated jumps with force plates, electrodes and rigid bodies from the simulator, exports the takes to every
format, and has them read by programs that are not ours.

    python check_recorded.py --mocapd target/debug/mocapd --mocapd-sim target/debug/mocapd-sim

mocapd must have the feature `full`. In C3D, read by ezc3d, the plates feel nothing during the flight, and the impulse of
the take-off agrees with the velocity of the body, which its markers have. All formats must have the same float32 bits at
the same times, and C3D the same values. Batches that are lost, and rates that do not fit the frames', must show.
One line a check; the last line is `N passed, N failed`; exit code 1 when one failed.
"""

import argparse
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import check_forces
import compare
import exports
import poses
import sampled

GRAVITY_M_S2 = 9.80665
READERS = {
    "csv": sampled.read_csv,
    "npz": sampled.read_npz,
    "xdf": sampled.read_xdf,
    "bids": sampled.read_bids,
    "parquet": sampled.read_parquet,
    "mcap": sampled.read_mcap,
}
LOST = """
seed = 5
[[fault]]
kind = "lost-frames"
rate = 0.05
"""


# The first one is the reference.
CLOCKS = {
    "even": "seed = 3",
    "clock-back": """
seed = 3
[[fault]]
kind = "clock-jump"
at_s = 2.0
by_s = -1
""",
    "clock-ahead": """
seed = 3
[[fault]]
kind = "clock-jump"
at_s = 2.0
by_s = 3
""",
    "power-loss": """
seed = 3
[[fault]]
kind = "power-loss"
at_s = 2.0
for_s = 0.5
""",
}


def run(*command):
    """What a program says on stderr."""
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    if result.returncode not in (0, 3):
        raise RuntimeError(f"{command[1]}: exit {result.returncode}: {result.stderr.strip()[-300:]}")
    return result.stderr


class Recorder:
    """Records what the simulator plays."""

    def __init__(self, mocapd, mocapd_sim, folder):
        self.mocapd, self.mocapd_sim, self.folder = mocapd, mocapd_sim, folder

    def record(self, name, *what):
        rig, take = self.folder / f"{name}.rig", self.folder / f"{name}.take"
        command = [self.mocapd_sim, "serve", *what, f"--pty={rig}", "--once"]
        with subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as served:
            try:
                # It names its port as soon as it has opened it.
                if not served.stdout.readline():
                    raise RuntimeError(served.stderr.read().decode()[-300:])
                run(self.mocapd, "record", "--device", f"serial:{rig}", "--output", take)
                served.communicate(timeout=30)
            finally:
                served.kill()
        return take

    def export(self, take, kind, *options):
        """The path of the export, and what was said of it."""
        path = take.with_suffix(f".{kind}")
        return path, run(self.mocapd, "export", take, "-o", path, *(["--format", "bids"] if kind == "bids" else []), *options)


def read_c3d(path):
    import ezc3d

    return ezc3d.c3d(str(path), extract_forceplat_data=True)


def pelvis_m(file):
    """The heights of the pelvis, in metres."""
    labels = [label.strip() for label in file["parameters"]["POINT"]["LABELS"]["value"]]
    return file["data"]["points"][2, labels.index("pelvis")] / 1000


def check_physics(file):
    """The flight and the take-off of a jump, by its forces and by its markers."""
    force_n = sum(plate["force"][2] for plate in file["data"]["platform"])
    rate_hz, frame_hz = (file["parameters"][group]["RATE"]["value"][0] for group in ("ANALOG", "POINT"))
    ratio = round(rate_hz / frame_hz)
    height_m = pelvis_m(file)
    # The flight: the frames around the highest point, in which only gravity acts, as markers say.
    top = int(np.argmax(height_m))
    airborne = np.arange(top - round(0.1 * frame_hz), top + round(0.1 * frame_hz))
    parabola = np.polyfit(airborne / frame_hz, height_m[airborne], 2)
    if abs(-2 * parabola[0] / GRAVITY_M_S2 - 1) > 0.05:
        return [f"the body falls at {-2 * parabola[0]:.2f} m/s^2"]
    flight = force_n[airborne[0] * ratio : airborne[-1] * ratio]
    wrong = [] if flight.size > 100 and not flight.any() else [f"up to {np.abs(flight).max()} N in flight"]
    # It begins where the plates feel nothing any more.
    begins = airborne[0] * ratio
    while force_n[begins - 1] == 0:
        begins -= 1
    velocity_m_s = np.polyval(np.polyder(parabola), begins / rate_hz)
    weight_n = force_n[: round(0.3 * rate_hz)].mean()
    lowest = int(np.argmin(height_m[: begins // ratio])) * ratio
    impulse_n_s = (force_n[lowest:begins] - weight_n).sum() / rate_hz
    by_forces_m_s = impulse_n_s / (weight_n / GRAVITY_M_S2)
    share = by_forces_m_s / velocity_m_s
    print(f"     take-off at {velocity_m_s:.3f} m/s by markers, {by_forces_m_s:.3f} m/s by forces, {flight.size} samples of flight")
    if not (velocity_m_s > 1 and abs(share - 1) <= 0.02):
        wrong.append(f"the impulse gives {by_forces_m_s:.3f} m/s, the markers {velocity_m_s:.3f}")
    return wrong


def check_formats(recorder, take, kinds):
    """The same bits at the same times in every format. Yields a name and complaints for each; returns the tables of CSV."""
    first = {}
    for kind, read in READERS.items():
        path, _ = recorder.export(take, kind)
        wrong = exports.validate_bids(path) if kind == "bids" else []
        for table in kinds:
            found = read(path, table)
            if found is None:
                wrong.append(f"{table} is missing")
                continue
            wanted = first.setdefault(table, found)
            if found.names != wanted.names or list(found.units) != list(wanted.units):
                wrong.append(f"{table}: other channels")
            if not compare.same_bits(np.ascontiguousarray(found.values), np.ascontiguousarray(wanted.values)):
                wrong.append(f"{table}: other bits")
            # MCAP has whole nanoseconds of a date.
            if found.times_s.shape != wanted.times_s.shape or np.abs(found.times_s - wanted.times_s).max() > (2e-6 if kind == "mcap" else 1e-9):
                wrong.append(f"{table}: other times")
        yield f"{take.stem} {kind}", wrong
    recorder.tables = first


def check_c3d(file, tables):
    """The samples of C3D against those of CSV, at the instants that C3D gives them."""
    wrong = []
    rate_hz = file["parameters"]["ANALOG"]["RATE"]["value"][0]
    values, first = file["data"]["analogs"][0].T, 0
    units = sampled.texts(file["parameters"]["ANALOG"], "UNITS", values.shape[1])
    written = np.zeros(values.shape, dtype=bool)
    for table in tables:
        n = table.values.shape[1]
        at = np.round(table.times_s * rate_hz).astype(int)
        inside = (at >= 0) & (at < len(values)) & np.isfinite(table.values).all(axis=1)
        factors = np.array([1000.0 if unit == "Nmm" else 1.0 for unit in units[first : first + n]])
        apart = np.abs(values[at[inside], first : first + n] / factors - table.values[inside])
        if len(set(at)) != len(at) or (apart > 2e-7 * np.abs(table.values[inside]) + 1e-30).any():
            wrong.append(f"{table.names[0]}...: {len(at) - len(set(at))} instants twice, up to {apart.max()} apart")
        written[at[inside], first : first + n] = True
        first += n
    if first != values.shape[1]:
        wrong.append(f"{values.shape[1]} channels for {first}")
    if values[~written].any():
        wrong.append("a missing sample is not 0")
    return wrong


def check_loads(file, table):
    """The loads of CSV against those that ezc3d calculates from C3D."""
    wrong, rate_hz = [], file["parameters"]["ANALOG"]["RATE"]["value"][0]
    for number, plate in enumerate(file["data"]["platform"]):
        loads = sampled.loads(plate)
        at = np.round(table.times_s * rate_hz).astype(int)
        for place, (quantity, _, tolerance) in enumerate(sampled.QUANTITIES):
            columns = 12 * number + 3 * place + np.arange(3)
            found, wanted = table.values[:, columns], loads[quantity][at]
            apart = np.abs(found - wanted)
            far = apart > np.maximum(tolerance, 1e-6 * np.abs(wanted))
            if far.any() or (np.isnan(found) != np.isnan(wanted)).any():
                wrong.append(f"plate {number + 1}: {quantity} differs by up to {np.nanmax(apart)}")
    return wrong


def check_mot(path, table):
    """The columns of .mot, with y up, against the loads of CSV, with z up."""
    names, rows = check_forces.read_mot(path)
    wrong = [] if np.allclose(rows[:, 0], table.times_s, atol=1e-9) else ["other times"]
    for number in range(table.values.shape[1] // 12):
        own = table.values[:, 12 * number : 12 * number + 12].reshape(-1, 4, 3).astype(np.float64)
        loaded = np.isfinite(own[:, 2]).all(axis=1)
        place = names.index(f"ground_force_{number + 1}_vx")
        found = rows[:, place : place + 9].reshape(-1, 3, 3)
        wanted = [check_forces.y_up(own[:, quantity], "z") for quantity in (0, 2, 3)]
        wanted[1] /= 1000
        for column, values in enumerate(wanted):
            if found[~loaded].any() or np.abs(found[loaded, column] - values[loaded]).max() > 1e-3:
                wrong.append(f"plate {number + 1}: column {column} differs")
    return wrong


def check_jump(recorder):
    """Rates that fit: the physics of a jump, and the same samples everywhere."""
    what = ["--generate", "jump", "--rate", "100Hz", "--seconds", "7s", "--plates", "--emg", "3@1kHz"]
    take = recorder.record("jump", *what)
    path, said = recorder.export(take, "c3d")
    file = read_c3d(path)
    yield "the flight and the take-off of a recorded jump", check_physics(file)
    kinds = ["sampled_0", "sampled_1", "force_plates"]
    yield from check_formats(recorder, take, kinds)
    tables = recorder.tables
    yield "jump c3d samples", check_c3d(file, [tables["sampled_0"], tables["sampled_1"]])
    yield "jump c3d loads", check_loads(file, tables["force_plates"])
    yield "jump mot", check_mot(recorder.export(take, "mot")[0], tables["force_plates"])
    times_s = tables["sampled_0"].times_s
    yield "jump times", [] if np.abs(times_s - np.arange(len(times_s)) / 1000).max() < 1e-4 else [f"{times_s}"]
    part, _ = recorder.export(take, "trc")
    yield "jump trc", [] if part.exists() and "sampled channels" in _ else ["trc does not say what it leaves out"]


def check_misfit(recorder):
    """Rates that do not fit: left out of C3D, or resampled."""
    what = ["--generate", "jump", "--rate", "120Hz", "--seconds", "7s", "--plates", "--emg", "2@500Hz"]
    take = recorder.record("misfit", *what)
    path, said = recorder.export(take, "c3d")
    alone = read_c3d(path)
    complaints = [] if alone["data"]["analogs"].size == 0 else ["samples that do not fit are in the file"]
    yield "misfit c3d", complaints + ([] if said.count("--resample writes it") == 2 else [said])
    path.unlink()
    path, said = recorder.export(take, "c3d", "--resample")
    file = read_c3d(path)
    rate_hz = file["parameters"]["ANALOG"]["RATE"]["value"][0]
    complaints = [] if rate_hz == 1080 and said.count("windowed sinc") == 2 else [f"{rate_hz} Hz: {said}"]
    table = sampled.read_csv(recorder.export(take, "csv")[0], "sampled_0")
    vertical = table.names.index("Fz1")
    instants = np.arange(file["data"]["analogs"].shape[2]) / rate_hz
    wanted = np.interp(instants, table.times_s, table.values[:, vertical])
    found = file["data"]["analogs"][0, vertical]
    # A filter has its say about steps, where the feet leave the plate and come down; elsewhere the force is smooth.
    steps = table.times_s[1:][np.abs(np.diff(table.values[:, vertical])) > 20]
    quiet = (instants > 0.05) & (instants < instants[-1] - 0.05)
    for step in steps:
        quiet &= np.abs(instants - step) > 0.04
    apart = np.abs(found - wanted)[quiet].max()
    print(f"     resampled: {quiet.mean():.0%} of the samples compared, up to {apart:.3f} N apart")
    yield "misfit c3d, resampled", complaints + ([] if apart < 1.0 and quiet.mean() > 0.5 else [f"{apart} N apart"])


def check_lost(recorder):
    """Batches that are lost: NaN everywhere, 0 and a warning in C3D."""
    script = recorder.folder / "lost.toml"
    script.write_text(LOST, encoding="utf-8")
    what = ["--generate", "jump", "--rate", "100Hz", "--seconds", "3s", "--plates", "--faults", script]
    take = recorder.record("lost", *what)
    yield from check_formats(recorder, take, ["sampled_0", "force_plates"])
    table = recorder.tables["sampled_0"]
    n_lost = int(np.isnan(table.values).all(axis=1).sum())
    yield "lost samples are NaN", [] if n_lost >= 10 and n_lost < len(table.values) // 2 else [f"{n_lost} lost"]
    path, said = recorder.export(take, "c3d")
    complaints = [] if f"lacks {n_lost} samples" in said and "written as 0" in said else [f"{n_lost} lost: {said}"]
    yield "lost c3d", complaints + check_c3d(read_c3d(path), [table])


def check_clock(recorder):
    """A device whose clock goes back by a second, or that loses its power: samples stay with the frames of their time."""
    what = ["--generate", "jump", "--rate", "100Hz", "--plates"]
    reference_s = None
    for name, script in CLOCKS.items():
        path = recorder.folder / f"{name}.toml"
        path.write_text(script, encoding="utf-8")
        take = recorder.record(name, *what, "--seconds", "7s", "--faults", path)
        table = sampled.read_csv(recorder.export(take, "csv")[0], "sampled_0")
        frames = np.genfromtxt(take.with_suffix(".csv"), delimiter=",", names=True)
        # The pelvis is highest in the flight.
        total = table.values[:, 2] + table.values[:, 8]
        top_s = frames["time_s"][np.nanargmax(frames["pelvisz"])]
        airborne = np.flatnonzero(total == 0)
        airborne = airborne[np.abs(table.times_s[airborne] - top_s) < 0.4]
        middle_s = (table.times_s[airborne[0]] + table.times_s[airborne[-1]]) / 2
        complaints = [] if (np.diff(table.times_s) > 0).all() else ["times do not ascend"]
        # The body comes down lower than it leaves: the middle of the flight is later than its top, in each take by as much.
        apart_s = middle_s - top_s
        reference_s = apart_s if reference_s is None else reference_s
        if not 0 < apart_s < 0.06 or abs(apart_s - reference_s) > 0.002:
            complaints.append(f"the flight is {apart_s:.4f} s after the top, {reference_s:.4f} s without a fault")
        n_placed = int(np.isfinite(table.values[:, 2]).sum())
        if n_placed < 6000:
            complaints.append(f"only {n_placed} samples")
        yield f"{name}: samples and frames", complaints


# Markers at the ends of a segment stand still in the axes of its body.
SEGMENTS = {
    "trunk": ["throat", "l_shoulder"],
    "l_thigh": ["l_hip", "l_knee"],
    "r_shank": ["r_knee", "r_ankle"],
    "l_upper_arm": ["l_shoulder", "l_elbow"],
    "r_forearm": ["r_elbow", "r_wrist"],
}


def check_rigid(path):
    """The poses against the markers, which the device sends apart from them: a point p of a body is at position + q p q*."""
    wrong = []
    with np.load(path) as found:
        labels, names = found["labels"].tolist(), found["body_names"].tolist()
        for body, markers in SEGMENTS.items():
            place = names.index(body)
            tracked = found["pose_states"][:, place] == 0
            turn = Rotation.from_quat(found["pose_quaternions"][tracked, place].astype(float), scalar_first=True)
            for marker in markers:
                apart = found["positions_mm"][tracked, labels.index(marker)] - found["pose_positions_mm"][tracked, place]
                spread_mm = np.nanstd(turn.inv().apply(apart.astype(float)), axis=0).max()
                wrong += [] if spread_mm < 1 else [f"{marker} moves by {spread_mm:.1f} mm in the axes of {body}"]
    return wrong


def check_poses(recorder):
    """Rigid bodies: the same poses in all formats, as one turns, and where the device does not track them."""
    script = recorder.folder / "poses.toml"
    script.write_text(LOST, encoding="utf-8")
    what = ["--generate", "jump", "--rate", "100Hz", "--seconds", "4s", "--bodies", "11"]
    for name, options in {"poses": [], "poses-lost": ["--faults", script]}.items():
        take = recorder.record(name, *what, *options)
        first = None
        for kind, read in poses.READERS.items():
            path, said = recorder.export(take, kind)
            found = read(path)
            first = first or found
            wrong = exports.validate_bids(path) if kind == "bids" else []
            yield f"{name} {kind}", wrong + poses.differences(found, first) + ([said] if "rigid bod" in said else [])
        tracked = np.isfinite(first.positions[..., 0])
        length = np.linalg.norm(first.quaternions[tracked], axis=-1)
        wrong = [] if np.abs(length - 1).max() < 1e-6 else [f"lengths of {length.min()} to {length.max()}"]
        wrong += [] if np.array_equal(tracked, first.states == 0) else ["states do not say which are tracked"]
        wrong += [] if first.positions.shape[1] == 11 and tracked.mean() > 0.8 else [f"{tracked.mean():.0%} tracked"]
        is_missing = (first.states == 253).all(axis=1)
        wrong += [] if is_missing.any() == bool(options) else [f"{is_missing.sum()} frames without poses"]
        wrong += check_rigid(take.with_suffix(".npz"))
        yield f"{name}: {tracked.mean():.1%} tracked, {is_missing.sum()} frames without poses", wrong
    # The same with y up: positions and axes of the bodies turn together.
    take.with_suffix(".npz").unlink()
    path, _ = recorder.export(take, "npz", "--up", "y")
    turned = poses.read_npz(path)
    tracked = np.isfinite(first.positions[..., 0])
    wanted = first.positions[tracked][:, [0, 2, 1]] * [1, 1, -1]
    wrong = [] if np.array_equal(turned.positions[tracked], wanted) else ["positions did not turn"]
    before, after = (Rotation.from_quat(found.quaternions[tracked], scalar_first=True) for found in (first, turned))
    quarter = Rotation.from_matrix([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    apart = (quarter * before * after.inv()).magnitude().max()
    yield "poses turned", wrong + ([] if apart < 1e-6 else [f"rotations are {np.degrees(apart)} degrees apart"])
    part, said = recorder.export(take, "trc")
    yield "poses trc", [] if "the poses of 11 rigid bodies" in said else ["trc does not say that poses are left out"]


def attempt(check, recorder):
    """The lines of a check."""
    lines = []
    try:
        for name, complaints in check(recorder):
            lines.append((not complaints, f"{name} {'; '.join(map(str, complaints))}"))
    except Exception as problem:  # the other checks still count
        lines.append((False, f"{check.__name__}: {type(problem).__name__}: {problem}"))
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd", required=True, type=Path)
    parser.add_argument("--mocapd-sim", required=True, type=Path)
    arguments = parser.parse_args()
    programs = arguments.mocapd.resolve(), arguments.mocapd_sim.resolve()
    passed = failed = 0
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(4) as pool:
        checks = [check_jump, check_misfit, check_lost, check_clock, check_poses]
        # The simulator plays in real time.
        for lines in pool.map(lambda check: attempt(check, Recorder(*programs, Path(folder))), checks):
            for good, line in lines:
                print(f"{'ok  ' if good else 'FAIL'} {line.strip()}"[:600], flush=True)
                passed += good
                failed += not good
    print(f"{passed} passed, {failed} failed")
    sys.exit(failed > 0 or passed == 0)


if __name__ == "__main__":
    main()
