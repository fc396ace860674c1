"""Records one simulated motion through a serial line, QTM, NatNet and LSL, at the same time, and compares the takes with `mocapd diff`:
the table of docs/networks.md.

    python one_motion.py --mocapd target/release/mocapd --mocapd-sim target/release/mocapd-sim

Prints the table, and as its last line `N passed, N failed`, which are takes; exit code 1 when a take is incomplete, or a float is
further from the serial line's than its units explain. USB is compared with a serial port in the emulated machine: the scenario `record:
one motion by both` of `tests/vm/run usb`.
"""

import argparse
import concurrent.futures
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

RATE_HZ, N_FRAMES, N_MARKERS = 240, 1200, 24
MOTION = ["--generate", "jump:7", "--rate", str(RATE_HZ), "--markers", str(N_MARKERS), "--seconds", f"{N_FRAMES // RATE_HZ}s"]
# How far a float in metres may be from the one in millimetres: half a step of float32 at 4 m, and the rounding back to millimetres.
UNITS_MM = 0.0003
# What a stream may send before the recorder has connected: 5 frames of NatNet on an idle machine.
SKIPPED_MAX = 2 * RATE_HZ
# Another simulator or recording on this machine has streams of the same name, and ports.
LSL_CONFIGURATION = f"""[ports]
BasePort={17_000 + os.getpid() % 400 * 32}
[multicast]
ResolveScope=machine
[lab]
KnownPeers={{127.0.0.1}}
SessionID=one-motion-{os.getpid()}
"""
FAMILIES = {
    "serial": [],
    "qtm": ["--protocol", "qtm", "--tcp"],
    "natnet": ["--protocol", "natnet"],
    "lsl": ["--protocol", "lsl"],
}


class Incomplete(Exception):
    """What is wrong with a take."""


def record(options, family, folder):
    """A take of the motion, and the number of the frame that it begins with."""
    take, line = folder / f"{family}.take", folder / "line"
    words = FAMILIES[family] or [f"--pty={line}"]
    simulator = subprocess.Popen([options.mocapd_sim, "serve", *MOTION, *words],
                                 stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        # It names its device once that can be opened.
        named = simulator.stdout.readline().strip()
        uri = f"serial:{line}" if family == "serial" else named
        command = [options.mocapd, "record", "-d", uri, "-o", take, "--lossless", "--json", "--seconds", "12s"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    finally:
        simulator.terminate()
        simulator.wait(10)
    if done.returncode not in (0, 3) or not take.exists():
        raise Incomplete(done.stderr)
    report = json.loads(done.stdout)
    if not report["ledger"]["closes"] or report["ledger"]["recorded"] != report["ledger"]["frames_sent"]:
        raise Incomplete(f"frames are lost: {report['ledger']}")
    if family == "serial" and report["frames"] != N_FRAMES:
        raise Incomplete(f"{report['frames']} frames")
    skipped = N_FRAMES - report["frames"]
    if not 0 <= skipped <= SKIPPED_MAX:
        raise Incomplete(f"{report['frames']} frames of {N_FRAMES}")
    return take, skipped


def diff(options, a, b):
    done = subprocess.run([options.mocapd, "diff", a, b, "--json"], capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise Incomplete(done.stderr)
    return json.loads(done.stdout)


def compared(options, serial, take, skipped, folder):
    """The differences from the serial line's take, from the frame on with which this one begins."""
    if skipped:
        # A stream that runs on while the recorder connects: its first frames were sent before.
        cut = folder / f"serial-from-{skipped}.take"
        command = [options.mocapd, "cut", serial, "-o", cut, "--frames", f"{skipped}.."]
        subprocess.run(command, check=True, capture_output=True)
        serial = cut
    found = diff(options, serial, take)
    motion = found["motion"]
    fields = {field["field"]: (field["a"], field["b"]) for field in found["content"]["header"]}
    if motion["frames_missing"] or motion["markers_differing"] or motion["gaps_differing"]:
        raise Incomplete(motion)
    if motion["max_distance_mm"] > UNITS_MM:
        raise Incomplete(f"{motion['max_distance_mm']} mm away")
    return motion, fields


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd", required=True, type=Path)
    parser.add_argument("--mocapd-sim", required=True, type=Path)
    options = parser.parse_args()
    options.mocapd, options.mocapd_sim = options.mocapd.resolve(), options.mocapd_sim.resolve()
    print("| through | frames | samples that differ from the serial line's | by at most | ticks of the clock | up axis |")
    print("|---|---|---|---|---|---|")
    passed = 0
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "lsl.cfg").write_text(LSL_CONFIGURATION)
        os.environ["LSLAPICFG"] = str(folder / "lsl.cfg")
        with concurrent.futures.ThreadPoolExecutor(len(FAMILIES)) as pool:
            takes = {family: pool.submit(record, options, family, folder) for family in FAMILIES}
        for family in FAMILIES:
            try:
                print(row(options, family, takes, folder), flush=True)
                passed += 1
            except Exception as problem:  # any failure is this take's, the others still count
                print(f"FAIL {family}: {type(problem).__name__}: {problem}", flush=True)
    print(f"{passed} passed, {len(FAMILIES) - passed} failed")
    sys.exit(passed != len(FAMILIES))


def row(options, family, takes, folder):
    """A row of the table."""
    serial, _ = takes["serial"].result()
    if family == "serial":
        return f"| serial | {N_FRAMES} | | | 10000000 Hz | z |"
    take, skipped = takes[family].result()
    motion, fields = compared(options, serial, take, skipped, folder)
    differing, samples = motion["samples_differing"], motion["samples"]
    tick_hz = fields.get("device.tick_hz", ("", "10000000"))[1]
    up = fields.get("up_axis", ("", "z"))[1]
    return f"| {family} | {N_FRAMES - skipped} | {differing} of {samples} | {motion['max_distance_mm']:.5f} mm | {tick_hz} Hz | {up} |"


if __name__ == "__main__":
    main()
