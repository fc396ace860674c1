"""Excessive sizes, invalid arguments, special files and interrupts: an exception, and the interpreter survives."""

import os
import signal
import socket
import struct
import subprocess
import sys
import time
import zlib

import numpy as np
import pytest

import mocapd

STRETCH = 0x03


def varint(value):
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def chunk(kind, payload):
    body = bytes([kind]) + varint(len(payload)) + payload
    return body + zlib.crc32(body).to_bytes(4, "little")


def string(text):
    return bytes([len(text)]) + text.encode()


def header():
    """HEADER of a recording of two markers at 120 Hz, as in docs/take-format.md."""
    device = b"".join(string(text) for text in ("dvmc", "", "", "", "")) + bytes([100, 0])
    channels = b"\x03M00\x21" + b"1"
    payload = (
        struct.pack("<H", 2) + string("tests") + bytes(16) + b"\x00" + string("dense") + b"\x06"
        + struct.pack("<dd", 0.5, 120.0) + b"\x03" + b"\x01" + device + b"\x00"
        + bytes([len(channels)]) + channels + bytes([60]) + b"\x00"
    )  # fmt: skip
    return b"\x89TAK\r\n\x1a\n" + chunk(0x01, payload)


@pytest.fixture
def years_lost(tmp_path):
    """A recording whose only stretch has no frames and states that 2^32 were lost before it."""
    # Key, number 0; a time line, with runs and rows listed; from row 0, no rows; one run of lost rows, all damaged.
    stretch = bytes([0x01, 0x07]) + varint(0) + varint(0) + varint(1) + varint(2**33 | 1) + b"\x08"
    to = tmp_path / "lost.take"
    to.write_bytes(header() + chunk(STRETCH, stretch))
    return to


def test_years_of_lost_frames_are_one_run(years_lost):
    with pytest.warns(mocapd.TakeWarning):
        take = mocapd.open(years_lost)
    assert take.n_frames == 2**32 and take.labels == ("M00", "M01")
    assert take.lost == (mocapd.LostFrames(0, 2**32, "damaged"),)
    for refused in (take.times, take.read, lambda: take[:], lambda: take.positions, take.to_xarray, take.to_pandas):
        with pytest.raises(ValueError, match=str(2**32)):
            refused()
    with pytest.raises((ValueError, mocapd.TakeError)):
        mocapd.decompress(years_lost.read_bytes())
    assert take.times(1000, 1001).frame.size == 120
    assert np.isnan(take.read(1000, 1001, 0)).all()
    assert take.summary["M00"].n_samples == 0


def test_an_end_before_the_start_is_refused(path):
    take = mocapd.open(path)
    for wrong, ends in (
        (lambda: take.read(5, 4), "5.* 4"),
        (lambda: take.read(start_frame=5, stop_frame=4), "5.* 4"),
        (lambda: take.read(5.0, stop_frame=4), "600.* 4"),
        (lambda: take.read(5000, 4000), "5000.* 4000"),
        (lambda: take.times(5, 4), "5.* 4"),
        (lambda: take["M00"].read(5, 4), "5.* 4"),
        (lambda: take.to_pandas(5, 4), "5.* 4"),
        (lambda: take.to_xarray(5, 4), "5.* 4"),
    ):
        with pytest.raises(ValueError, match=ends):
            wrong()
    # A part beyond the end is empty, and an empty part is valid.
    assert len(take.read(4000, 5000)) == 0
    assert len(take.read(5, 5)) == 0
    assert len(take[5:4]) == 0


def test_errors_name_the_file(tmp_path, path):
    no_take = tmp_path / "no.take"
    no_take.write_bytes(b"nothing")
    with pytest.raises(mocapd.TakeError, match="no.take"):
        mocapd.open(no_take)
    data = bytearray(path.read_bytes())
    data[20] ^= 1
    data[30] ^= 1
    damaged = tmp_path / "header.take"
    damaged.write_bytes(data)
    with pytest.raises(mocapd.TakeError, match="header.take"):
        mocapd.open(damaged)
    with pytest.raises(FileNotFoundError) as caught:
        mocapd.open(tmp_path / "none.take")
    assert caught.value.filename == str(tmp_path / "none.take")


def test_a_path_with_a_zero_byte_is_refused(motion, labels):
    with pytest.raises(ValueError):
        mocapd.open("a\0b.take")
    with pytest.raises(ValueError):
        mocapd.write_take("a\0b.take", motion, labels, 120.0)


def test_invalid_rates_are_refused(tmp_path, motion, labels):
    for rate_hz in (1e300, 1e7, 1e-4, 0.0, -1.0, float("inf"), float("nan")):
        with pytest.raises(ValueError, match="Hz"):
            mocapd.write_take(tmp_path / "rate.take", motion[:100], labels, rate_hz)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes need POSIX")
def test_special_files_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.take")
    os.symlink("/dev/zero", tmp_path / "device.take")
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(tmp_path / "socket.take"))
    reasons = set()
    for what in ("pipe", "device", "socket"):
        code = "import mocapd, sys\ntry: mocapd.open(sys.argv[1])\nexcept OSError as e: print(e)"
        ran = subprocess.run(
            [sys.executable, "-c", code, tmp_path / f"{what}.take"], capture_output=True, text=True, timeout=60
        )
        assert f"{what}.take" in ran.stdout, ran
        reasons.add(ran.stdout.replace(f"{what}.take", ""))
    assert len(reasons) == 3, reasons
    listener.close()
    with pytest.raises(IsADirectoryError):
        mocapd.open(tmp_path)


def interrupted(code, *args):
    """Seconds from Ctrl-C to the end of a running program."""
    # A process started in the background may ignore SIGINT.
    code = f"import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n{code}"
    program = subprocess.Popen(
        [sys.executable, "-c", code, *map(str, args)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert program.stdout.readline() == "begins\n"
    time.sleep(0.5)
    assert program.poll() is None, program.stderr.read()
    started_s = time.monotonic()
    program.send_signal(signal.SIGINT)
    try:
        _, output = program.communicate(timeout=30)
    except subprocess.TimeoutExpired:
        program.kill()
        program.communicate()
        pytest.fail("Ctrl-C was not answered within 30 s")
    assert "KeyboardInterrupt" in output, output
    return time.monotonic() - started_s


@pytest.mark.skipif(os.name != "posix", reason="the test sends POSIX signals")
def test_ctrl_c_interrupts_long_work(path, tmp_path):
    # A sparse file: a hundred gigabytes to scan, no disk space.
    data = path.read_bytes()
    long = tmp_path / "long.take"
    long.write_bytes(data[: len(data) // 2])
    os.truncate(long, 100 << 30)
    opening = "import mocapd, sys\nprint('begins', flush=True)\nmocapd.open(sys.argv[1])"
    coding = (
        "import mocapd, numpy\n"
        "array = numpy.cumsum(numpy.random.default_rng(1).normal(0, 3, (120_000, 100, 3)), 0, numpy.float32)\n"
        "print('begins', flush=True)\n"
        "mocapd.compress(array, 0.01, threads=1)"
    )
    # Includes the exit of Python on a busy machine; on an idle one it takes 0.3 s.
    for code in (opening, coding):
        assert interrupted(code, long) < 5


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems round the size of a stack differently")
def test_without_a_thread_there_is_an_exception(path):
    # No address space can hold such a stack.
    code = (
        "import mocapd, numpy, sys\n"
        "for work in (lambda: mocapd.open(sys.argv[1]), lambda: mocapd.compress(numpy.zeros((9, 1, 3), numpy.float32), 1)):\n"
        "    try: work()\n"
        "    except OSError as e: print(type(e).__name__)"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code, path],
        capture_output=True, text=True, timeout=60, env={**os.environ, "RUST_MIN_STACK": str(1 << 60)},
    )  # fmt: skip
    assert (ran.stdout.split(), ran.returncode) == (["BlockingIOError"] * 2, 0), ran
