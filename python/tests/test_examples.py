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


def test_a_picture_of_what_is_kept(path, tmp_path):
    pytest.importorskip("matplotlib")
    said = run("knots.py", path, "M01", "-o", tmp_path / "knots.png")
    assert "M01" in said and "4200" in said
    assert (tmp_path / "knots.png").read_bytes().startswith(b"\x89PNG")


def test_the_bars_are_measured(path):
    said = run("bars.py", path, "--runs", 1)
    assert "open" in said and "MB/s" in said
