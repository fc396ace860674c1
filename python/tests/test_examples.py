import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from c3d_files import c3d_file, channel_records, event_records, plate_records, walk
from test_force_plates import FRAMES, RATIO, SAMPLES, file_of, step

README = Path(__file__).parent.parent / "README.md"
EXAMPLES = Path(__file__).parent.parent / "examples"


def run(name, *arguments):
    command = [sys.executable, str(EXAMPLES / name), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_knots_plots_an_image(path, tmp_path):
    pytest.importorskip("matplotlib")
    output = run("knots.py", path, "M01", "-o", tmp_path / "knots.png")
    assert "M01" in output and "4200" in output
    assert (tmp_path / "knots.png").read_bytes().startswith(b"\x89PNG")


def test_bars_measures_reading(path):
    output = run("bars.py", path, "--runs", 1)
    assert "open" in output and "MB/s" in output


def test_forces_plots_an_image(imported, tmp_path):
    pytest.importorskip("matplotlib")
    known = [step(2), step(4, (900.0, 150.0, 20.0))]
    take = imported(file_of(known))
    output = run("forces.py", take.path, "-o", tmp_path / "forces.png")
    peaks_n = [np.linalg.norm(plate.force_n, axis=1).max() for plate in known]
    assert [line.split("most ")[1] for line in output.splitlines()] == [f"{peak:.0f} N" for peak in peaks_n]
    assert (tmp_path / "forces.png").read_bytes().startswith(b"\x89PNG")


def test_the_readme_reads_force_plates_as_written(imported, tmp_path):
    pytest.importorskip("pandas")
    (code,) = re.findall(r'```python\n(import mocapd\n\nwith mocapd.open\("walk.take"\).*?)```', README.read_text(), re.DOTALL)
    plate = step(2)
    emg = 0.01 * np.sin(np.arange(SAMPLES) / 3)[:, None]
    channels = np.concatenate([plate.channels(), emg], axis=1)
    labels = ["Fx1", "Fy1", "Fz1", "Mx1", "My1", "Mz1", "EMG1"]
    units = ["N"] * 3 + ["Nmm"] * 3 + ["mV"]
    records = channel_records(7, labels=labels, units=units) + plate_records([plate])
    records += event_records([0.1, 0.2], ["Left", "Left"], ["Foot Strike", "Foot Off"])
    take = imported(c3d_file(walk(FRAMES), channels, RATIO, records))
    Path(take.path).rename(tmp_path / "walk.take")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "mV 1000.0 channel 7" in done.stdout and "['mm']" in done.stdout
    assert f"{plate.force_n[:, 2].max():.2f}"[:-1] in done.stdout
