"""Talks to `mocapd-sim serve --protocol ndi` with clients of NDI systems that are not ours.

    python check_ndi.py --mocapd-sim target/release/mocapd-sim --mocapd target/release/mocapd

ndicapi is the library that PlusToolkit and 3D Slicer use; scikit-surgerynditracker is a tracker on top of it.
The simulator runs in another process: ndicapi holds the interpreter's lock while it waits. One line a check;
the last line is `N passed, N failed`; exit code 1 when one failed.

Of the library's own limits: `BX` comes back as text, and raises where its bytes are no UTF-8, after it was
read all the same; an error in place of a binary answer is told as a bad checksum; COMM knows no speed above
115200 on this system.
"""

import argparse
import contextlib
import json
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import ndicapy
import numpy as np
from sksurgerynditracker.nditracker import NDITracker

N_FRAMES = 200
N_STRAYS = 50
TOOLS = ("probe", "reference")
LABELS = TOOLS + tuple(f"m{k:02}" for k in range(N_STRAYS))
FIT_ERROR_MM = 0.25

# It names its line as soon as it has made it; a machine under load may take seconds to start it.
FIRST_WORD_WITHIN_S = 30.0


def position(column, frame):
    """Where a marker is, exactly as float32 has it; None while it is hidden."""
    hidden = (column == 1 and 100 <= frame < 150) or (column == 7 and 50 <= frame < 120)
    if hidden:
        return None
    return (10.0 * column + 0.5 * frame, -20.0 * column + 0.25 * frame, -1000.0 - 5.0 * column)


def strays(frame):
    seen = (position(column, frame) for column in range(len(TOOLS), len(LABELS)))
    return [place for place in seen if place is not None]


def write_motion(path):
    names = (f"{label}.{axis}" for label in LABELS for axis in "xyz")
    lines = ["frame,time_s," + ",".join(names)]
    for frame in range(N_FRAMES):
        cells = [str(frame), f"{frame / 60:.6f}"]
        for column in range(len(LABELS)):
            cells += [f"{v:g}" for v in position(column, frame) or ()] or ["", "", ""]
        lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n")


@contextlib.contextmanager
def simulator(program, motion, *more):
    """A simulated system in a process of its own: the path of its line."""
    tools = [word for tool in TOOLS for word in ("--tool", tool)]
    command = [program, "serve", motion, "--pty", "--protocol", "ndi", "--loop", *tools, *more]
    process = subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE,
                               stderr=subprocess.DEVNULL, text=True)
    silent = threading.Timer(FIRST_WORD_WITHIN_S, process.kill)
    silent.start()
    try:
        path = process.stdout.readline().strip()
        silent.cancel()
        expect(path, "the simulator names no line")
        yield path
    finally:
        silent.cancel()
        process.terminate()
        process.wait(10)


@contextlib.contextmanager
def opened(path):
    device = ndicapy.ndiOpen(path)
    expect(device is not None, "ndiOpen gives nothing")
    try:
        yield device
    finally:
        ndicapy.ndiClose(device)


def expect(holds, complaint):
    if not holds:
        raise AssertionError(complaint)


def command(device, text, error=0):
    """The answer; the library raises on an error that the system reports."""
    try:
        answer = ndicapy.ndiCommand(device, text)
    except OSError as problem:
        expect(f"0x{error:02x}:" in str(problem).lower(), f"{text}: {problem}, expected 0x{error:02X}")
        return ""
    expect(ndicapy.ndiGetError(device) == error == 0, f"{text}: {answer!r}, expected 0x{error:02X}")
    return answer


def bring_up(device):
    for text in ("INIT:", "COMM:50000", "PHSR:02", "PINIT:01", "PINIT:02", "PHSR:03", "PENA:01D", "PENA:02D"):
        command(device, text)
    expect(ndicapy.ndiGetPHSRNumberOfHandles(device) == 2, "not two handles")
    command(device, "TSTART:")


def check_probe(path):
    expect(ndicapy.ndiProbe(path) == ndicapy.NDI_OKAY, "ndiProbe does not find it")


def check_identity(path):
    with opened(path) as device:
        command(device, "INIT:")
        version = command(device, "VER:0")
        expect("NDI S/N: SIM0001" in version and "Freeze Tag: mocapd-sim" in version, version)
        rate = command(device, "GETINFO:Param.Tracking.Frame Frequency")
        expect(rate.startswith("Param.Tracking.Frame Frequency=60;"), rate)
        expect(command(device, "APIREV:").startswith("G.003."), "no API revision")
        expect(command(device, "BEEP:1") == "1", "no beep")
        bring_up(device)
        info = command(device, "PHINF:020005")
        expect(info[33:53].strip() == "reference" and len(info) == 53, info)
        command(device, "TSTOP:")
        expect(command(device, "RESET:0").startswith("RESET"), "no reset")
        command(device, "INIT:")


def check_errors(path):
    with opened(path) as device:
        # Whoever was here before has initialized it: a reset undoes that.
        command(device, "RESET:0")
        command(device, "PHSR:02", error=0x10)
        command(device, "INIT:")
        for text, error in (
            ("FOO:", 0x01), ("TX:0001", 0x0C), ("TSTOP:", 0x0C), ("PINIT:77", 0x08), ("PENA:01D", 0x0E),
            ("PENA:01X", 0x09), ("COMM:90000", 0x06), ("GET:Nothing", 0x23), ("PHSR:09", 0x07),
        ):
            command(device, text, error)
        command(device, "TSTART:")
        for text in ("TSTART:", "PINIT:01", "COMM:50000"):
            command(device, text, error=0x0C)
        command(device, "TSTOP:")


def bx(device, mode):
    with contextlib.suppress(UnicodeDecodeError):
        ndicapy.ndiBX(device, mode)
    expect(ndicapy.ndiGetError(device) == 0, "BX is refused")


def check_bx(path):
    with opened(path) as device:
        bring_up(device)
        numbers = [-1]
        # At 115200 baud an answer takes four frames: so many go once through the motion.
        while len(numbers) < 60:
            bx(device, 0x1801)
            number = ndicapy.ndiGetBXFrame(device, b"\1")
            frame = number % N_FRAMES
            expect(number >= numbers[-1], f"frame {number} after {numbers[-1]}")
            numbers += [number] * (number > numbers[-1])
            for column, handle in enumerate((b"\1", b"\2")):
                place = position(column, frame)
                expected = "MISSING" if place is None else (1.0, 0.0, 0.0, 0.0, *place, FIT_ERROR_MM)
                got = ndicapy.ndiGetBXTransform(device, handle)
                expect(got == expected, f"frame {number}: {got}, not {expected}")
            count = ndicapy.ndiGetBXNumberOfPassiveStrays(device)
            got = [ndicapy.ndiGetBXPassiveStray(device, index) for index in range(count)]
            expect(got == strays(frame), f"frame {number}: {count} strays, not {len(strays(frame))}")
            time.sleep(0.01)
        command(device, "TSTOP:")


def check_tx(path):
    with opened(path) as device:
        bring_up(device)
        for _ in range(60):
            ndicapy.ndiTX(device, 0x1001)
            expect(ndicapy.ndiGetError(device) == 0, "TX is refused")
            frame = ndicapy.ndiGetTXFrame(device, b"\1") % N_FRAMES
            for column, handle in enumerate((b"\1", b"\2")):
                place = position(column, frame)
                got = ndicapy.ndiGetTXTransform(device, handle)
                if place is None:
                    expect(got == "MISSING", f"frame {frame}: {got}")
                else:
                    # Hundredths of a millimetre.
                    expect(np.allclose(got[4:7], place, atol=0.0051), f"frame {frame}: {got}, not {place}")
            count = ndicapy.ndiGetTXNumberOfPassiveStrays(device)
            expect(count == len(strays(frame)), f"frame {frame}: {count} strays")
            time.sleep(0.03)
        command(device, "TSTOP:")


def frames_of(tracker, columns, n_frames):
    tracker.start_tracking()
    for _ in range(n_frames):
        _, _, numbers, tracking, quality = tracker.get_frame()
        expect(len(tracking) == len(columns), f"{len(tracking)} tools")
        for column, number, row, error in zip(columns, numbers, tracking, quality):
            place = position(column, int(number) % N_FRAMES)
            expected = [np.nan] * 7 if place is None else [1, 0, 0, 0, *place]
            expect(np.array_equal(row[0], expected, equal_nan=True), f"frame {number}: {row}, not {expected}")
            expect(place is None or error == FIT_ERROR_MM, f"frame {number}: error {error}")
        time.sleep(0.02)
    tracker.stop_tracking()
    tracker.close()


def check_tracker_wired(path):
    settings = {"tracker type": "aurora", "serial port": path, "use quaternions": True}
    frames_of(NDITracker(settings), (0, 1), 60)


def check_tracker_loaded(path):
    definition = bytearray(752)
    definition[:4] = b"NDI\0"
    definition[580:586] = b"mocapd"
    definition[592:601] = b"8700-TEST"
    with tempfile.NamedTemporaryFile(suffix=".rom") as rom:
        rom.write(definition)
        rom.flush()
        settings = {"tracker type": "polaris", "serial port": path, "romfiles": [rom.name], "use quaternions": True}
        tracker = NDITracker(settings)
        handles, _ = tracker.get_tool_descriptions()
        expect(handles == [0x0A], f"handles {handles}")
        # The first marker that is no tool plays it.
        frames_of(tracker, (len(TOOLS),), 60)


def check_recorder_afterwards(path, mocapd, frames_min):
    """The driver finds the system as another client left it: tracking, and at another speed."""
    with opened(path) as device:
        bring_up(device)
        bx(device, 0x1001)
    with tempfile.TemporaryDirectory() as folder:
        take = f"{folder}/t.take"
        record = [mocapd, "record", "-d", f"serial:{path}?driver=ndi", "-o", take, "--seconds", "2s", "--json"]
        ran = subprocess.run([str(word) for word in record], capture_output=True, text=True)
        # 3: a poll came late, or the line is too slow for every frame; the ledger says so.
        expect(ran.returncode in (0, 3), ran.stderr)
        report = json.loads(ran.stdout)
        expect(report["ledger"]["closes"] and report["frames"] >= frames_min, ran.stdout)
        expect(report["markers"] == len(TOOLS), ran.stdout)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd-sim", required=True, type=Path)
    parser.add_argument("--mocapd", required=True, type=Path)
    arguments = parser.parse_args()
    clients = [check_probe, check_identity, check_errors, check_bx, check_tx, check_tracker_wired, check_tracker_loaded]
    mocapd = arguments.mocapd.resolve()
    # 950 bytes a frame: 115200 baud carry 12 of them a second.
    jobs = [((), check, ()) for check in clients]
    jobs += [(("--baud", "115200"), check, ()) for check in clients]
    jobs += [(("--no-bx2",), check, ()) for check in clients if check is not check_identity]
    for more, frames_min in (((), 100), (("--baud", "115200"), 15), (("--no-bx2",), 100)):
        jobs.append((more, check_recorder_afterwards, (mocapd, frames_min)))
    passed = 0
    with tempfile.TemporaryDirectory() as folder:
        motion = Path(folder) / "motion.csv"
        write_motion(motion)
        for more, check, extra in jobs:
            name = " ".join((check.__name__.removeprefix("check_"), *more))
            try:
                with simulator(arguments.mocapd_sim.resolve(), motion, *more) as path:
                    check(path, *extra)
                print(f"ok   {name}", flush=True)
                passed += 1
            except Exception as problem:  # any failure is this check's, the others still count
                print(f"FAIL {name}: {type(problem).__name__}: {problem}", flush=True)
    print(f"{passed} passed, {len(jobs) - passed} failed")
    sys.exit(passed != len(jobs))


if __name__ == "__main__":
    main()
