"""The declared types match the module."""

import subprocess
import sys

import pytest

pytest.importorskip("mypy")


def run(*command):
    done = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_stub_matches_the_module():
    run("mypy.stubtest", "mocapd._native")


def test_the_package_is_typed_strictly(tmp_path):
    use = tmp_path / "use.py"
    use.write_text(
        "import mocapd\n"
        "take: mocapd.Take = mocapd.open('a.take')\n"
        "error: float = take.summary['a'].max_error_mm\n"
        "size: int = mocapd.write_take('b.take', take.positions, take.labels, take.rate_hz)\n"
        "again = mocapd.decompress(mocapd.compress(take.read(1, 2, ['a']), 0.5))\n"
        "x: float = float(again[0, 0, 0])\n"
    )
    run("mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), str(use))
