"""Exports the force plates of C3D files to .mot, and compares every load with what ezc3d calculates from the C3D file.

    python check_forces.py --mocapd target/release/mocapd [--takes FOLDER]

The files are those of the folder and generated ones, these also as ezc3d writes them. The .mot is read as OpenSim's
Storage reads it: whatever that would refuse or misread is an error. One line for each file
with force plates; the last line is `N passed, N failed`; exit code 1 when one failed.

ezc3d 1.7.2 gives the centre of pressure of unloaded plates as well; below 20 N the .mot has zeros. Plates whose type
ezc3d does not support are not compared.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import generated
from sampled import THRESHOLD_N


def read_mot(path):
    """The names of the columns, and the table."""
    lines = path.read_text(encoding="utf-8").split("\n")
    end = lines.index("endheader")
    header = dict(line.split("=", 1) for line in lines[1:end])
    assert "=" not in lines[0] and header["version"] == "1" and header["inDegrees"] in ("yes", "no"), lines[:end]
    names = lines[end + 1].split("\t")
    assert names[0] == "time" and len(set(names)) == len(names) == int(header["nColumns"]), names
    assert lines[-1] == ""
    table = np.array([[float(cell) for cell in line.split("\t")] for line in lines[end + 2 : -1]])
    assert table.shape == (int(header["nRows"]), len(names)), table.shape
    assert np.isfinite(table).all() and (np.diff(table[:, 0]) > 0).all()
    return names, table


def expected(path):
    """By ezc3d: of each plate forces (N), centres of pressure (m), free moments (N m) and the force along its normal."""
    import ezc3d

    platforms = ezc3d.c3d(str(path), extract_forceplat_data=True)["data"]["platform"]
    for plate in platforms:
        to_metres = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[plate["unit_position"].strip("\0 ")]
        corners = plate["corners"].T
        normal = np.cross(corners[0] - corners[1], corners[0] - corners[3])
        normal /= np.linalg.norm(normal)
        force = plate["force"].T
        yield force, plate["center_of_pressure"].T * to_metres, plate["Tz"].T * to_metres, force @ normal


def y_up(vectors, up):
    if up == "z":
        return np.stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]], axis=1)
    return vectors


def complaints(mocapd, path, folder):
    take, mot = folder / "a.take", folder / "a.mot"
    run(mocapd, "import", path, "-o", take, "--lossless")
    run(mocapd, "export", take, "-o", mot)
    up = json.loads(run(mocapd, "info", take, "--json"))["up_axis"]
    names, table = read_mot(mot)
    plates = list(expected(path))
    wrong = []
    if len(names) != 1 + 9 * len(plates):
        return [f"{(len(names) - 1) // 9} plates for {len(plates)}"]
    n_loaded = 0
    for number, (force, point, torque, normal_n) in enumerate(plates, 1):
        place = names.index(f"ground_force_{number}_vx")
        found = table[:, place : place + 9].reshape(-1, 3, 3)
        # Within rounding of the threshold either is right.
        loaded = np.abs(normal_n) > THRESHOLD_N * (1 + 1e-4)
        unloaded = np.abs(normal_n) < THRESHOLD_N * (1 - 1e-4)
        n_loaded += int(loaded.sum())
        if found[unloaded].any():
            wrong.append(f"plate {number}: an unloaded plate has a load")
        for column, (what, values, tolerance) in enumerate(
            [("force", force, 1e-2), ("centre of pressure", point, 1e-4), ("free moment", torque, 1e-2)]
        ):
            apart = np.abs(found[:, column] - y_up(values, up))[loaded]
            if apart.size and apart.max() > tolerance:
                wrong.append(f"plate {number}: {what} differs by {apart.max():.3g}")
    print(f"  {path.name}: {len(plates)} plates, {n_loaded} loads of {len(table) * len(plates)}")
    return wrong


def run(*command):
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    if result.returncode != 0:
        raise RuntimeError(f"{command[1]}: exit {result.returncode}: {result.stderr.strip()}")
    return result.stdout


def rewritten(path, folder):
    """The file as ezc3d writes it."""
    import ezc3d

    written = folder / f"{path.stem}-by-ezc3d.c3d"
    ezc3d.c3d(str(path)).write(str(written))
    return written


def has_plates(path):
    import ezc3d

    try:
        group = ezc3d.c3d(str(path))["parameters"].get("FORCE_PLATFORM", {})
    except (RuntimeError, OSError, ValueError):
        return False  # The file with a malformed parameter section.
    return bool(group) and group["USED"]["value"][0] > 0


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--mocapd", required=True)
    parser.add_argument("--takes", type=Path, help="recorded takes; without them only the generated ones")
    arguments = parser.parse_args()
    passed = failed = 0
    with tempfile.TemporaryDirectory() as own:
        recorded = sorted(arguments.takes.glob("*.c3d")) if arguments.takes else []
        made = list(filter(has_plates, [*generated.sampled(Path(own)), *generated.plates_with_matrices(Path(own))]))
        made += [rewritten(path, Path(own)) for path in made]
        for path in [*filter(has_plates, recorded), *made]:
            with tempfile.TemporaryDirectory() as folder:
                try:
                    wrong = complaints(arguments.mocapd, path, Path(folder))
                except (RuntimeError, AssertionError) as error:
                    wrong = [str(error)]
            passed, failed = passed + (not wrong), failed + bool(wrong)
            print(f"FAILED {path.name}: {'; '.join(wrong)}" if wrong else f"passed {path.name}")
    print(f"{passed} passed, {failed} failed")
    sys.exit(1 if failed or not passed else 0)


if __name__ == "__main__":
    main()
