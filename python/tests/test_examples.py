import subprocess
import sys
from pathlib import Path

import pytest

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
