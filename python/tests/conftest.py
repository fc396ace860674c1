"""Fixtures: generated motion, takes of it, the command line, and a test store."""

import os
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest

import mocapd

# Ray's workers are nice by 15: beside other load of the machine the tests of archives would take several times as long.
os.environ.setdefault("RAY_worker_niceness", "0")

RATE_HZ = 120.0


def make_motion(frames, markers, seed=7):
    """Sinusoids with noise of 0.05 mm; some markers are hidden for a while, the last one always."""
    random = np.random.default_rng(seed)
    t = np.arange(frames)[:, None, None] / RATE_HZ
    swing = random.uniform(20, 300, (1, markers, 3))
    speed = random.uniform(0.5, 6, (1, markers, 3))
    phase = random.uniform(0, 6, (1, markers, 3))
    positions = 900 + swing * np.sin(speed * t + phase) + random.normal(0, 0.05, (frames, markers, 3))
    for marker in range(0, markers - 1, 3):
        start = int(random.integers(0, max(1, frames - 40)))
        positions[start : start + int(random.integers(1, 40)), marker] = np.nan
    positions[:, markers - 1] = np.nan
    return positions.astype(np.float32)


@pytest.fixture(scope="session")
def motion():
    """35 s of 70 markers: two groups, four key stretches."""
    return make_motion(4200, 70)


@pytest.fixture(scope="session")
def labels(motion):
    return [f"M{column:02}" for column in range(motion.shape[1])]


@pytest.fixture(scope="session")
def path(motion, labels, tmp_path_factory):
    to = tmp_path_factory.mktemp("takes") / "made.take"
    mocapd.write_take(to, motion, labels, RATE_HZ, 0.5, up_axis="z")
    return to


@pytest.fixture(scope="session")
def program():
    """Path of the command line, from the environment variable MOCAPD."""
    if not os.environ.get("MOCAPD"):
        pytest.skip("the environment variable MOCAPD is not set")
    return Path(os.environ["MOCAPD"]).resolve()


@pytest.fixture(scope="session")
def recorded(program, tmp_path_factory):
    """A take recorded from a simulated device."""
    folder = tmp_path_factory.mktemp("demo")
    run(program, "demo", "--seconds", "12", "--out", folder / "out")
    return folder / "out" / "jump-001.take"


@pytest.fixture
def imported(program, tmp_path):
    """Imports the bytes of a C3D file, which stays as ``a.c3d``, and opens the take."""
    takes = []

    def imported(data, *options):
        (tmp_path / "a.c3d").write_bytes(data)
        takes.append(tmp_path / f"{len(takes)}.take")
        run(program, "import", tmp_path / "a.c3d", "-o", takes[-1], "--lossless", *options)
        return mocapd.open(takes[-1])

    return imported


def run(*command):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    assert done.returncode in (0, 3), done.stderr
    return done.stdout


def error_mm(found, original):
    """The largest distance between samples; both arrays must have the same gaps."""
    assert np.array_equal(np.isnan(found), np.isnan(original))
    apart = np.linalg.norm(found.astype(np.float64) - original, axis=-1)
    return float(np.nanmax(apart)) if np.isfinite(apart).any() else 0.0


@pytest.fixture(scope="session")
def endpoint():
    """A server of S3 with the bucket takes-test; its address and credentials are in the environment."""
    pytest.importorskip("moto")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-p", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    url = f"http://127.0.0.1:{port}"
    names = {"AWS_ENDPOINT_URL": url, "AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in names.items():
            patch.setenv(name, value)
        patch.delenv("AWS_PROFILE", raising=False)
        end = time.monotonic() + 60
        while True:
            try:
                urllib.request.urlopen(urllib.request.Request(f"{url}/takes-test", method="PUT"), timeout=5).close()
                break
            except OSError:
                assert server.poll() is None and time.monotonic() < end, "the test store did not start"
                time.sleep(0.1)
        yield url
    server.terminate()
    server.wait()
