"""The declared types match the module."""

import subprocess
import sys

import pytest

pytest.importorskip("mypy")


def run(*command):
    done = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def mypy(tmp_path_factory):
    """The command, with one cache for this file: NumPy's own types take most of the time."""
    return ["mypy", "--strict", "--cache-dir", str(tmp_path_factory.mktemp("mypy"))]


def test_the_stub_matches_the_module():
    run("mypy.stubtest", "mocapd._native")


def test_the_package_is_typed_strictly(tmp_path, mypy):
    use = tmp_path / "use.py"
    use.write_text(
        "import mocapd\n"
        "take: mocapd.Take = mocapd.open('a.take')\n"
        "error: float = take.summary['a'].max_error_mm\n"
        "size: int = mocapd.write_take('b.take', take.positions, take.labels, take.rate_hz)\n"
        "again = mocapd.decompress(mocapd.compress(take.read(1, 2, ['a']), 0.5))\n"
        "x: float = float(again[0, 0, 0])\n"
        "with mocapd.open('a.take') as take:\n"
        "    emg: float = float(take.analog['EMG1'].values[0])\n"
        "    unit: str = take.analog.channels[0].unit\n"
        "    plate: mocapd.ForcePlate = take.force_plates[0]\n"
        "    force_n: float = float(plate.read(1, 2).force_n[0, 2])\n"
        "    skeleton = take.subject.skeleton if take.subject else None\n"
        "    used = take.metadata['POINT']['USED']\n"
        "    rows: int = len(take.to_pandas('analog', 1, 2, ['EMG1'])) + len(take.to_pandas(1, 2, layout='long'))\n"
        "    columns = take.to_pandas('force_plates', 1).columns, take.to_pandas('events').columns\n"
    )
    run(*mypy, str(use))


def test_calls_that_fail_are_type_errors(tmp_path, mypy):
    use = tmp_path / "use.py"
    wrong = ["to_pandas('forces')", "to_pandas('events', 1, 2)", "to_pandas(layout='tidy')"]
    use.write_text("import mocapd\n" + "".join(f"mocapd.open('a.take').{call}\n" for call in wrong))
    done = subprocess.run([sys.executable, "-m", *mypy, str(use)], capture_output=True, text=True)
    refused = [line for line in done.stdout.splitlines() if "call-overload" in line]
    assert done.returncode == 1
    assert [line.split(":")[1] for line in refused] == ["2", "3", "4"], done.stdout
