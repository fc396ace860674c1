"""Records one simulated motion through a serial line, QTM, NatNet and LSL, and compares the takes with `mocapd diff`: the table of
docs/networks.md.

    python one_motion.py --mocapd target/release/mocapd --mocapd-sim target/release/mocapd-sim

Prints the table; exit code 1 when a take is incomplete, or a float is further from the serial line's than its units explain.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RATE_HZ, N_FRAMES, N_MARKERS = 240, 1200, 24
MOTION = ["--generate", "jump:7", "--rate", str(RATE_HZ), "--markers", str(N_MARKERS), "--seconds", f"{N_FRAMES // RATE_HZ}s"]
# How far a float in metres may be from the one in millimetres: half a step of float32 at 4 m, and the rounding back to millimetres.
UNITS_MM = 0.0003
FAMILIES = {
    "serial": [],
    "qtm": ["--protocol", "qtm", "--tcp"],
    "natnet": ["--protocol", "natnet"],
    "lsl": ["--protocol", "lsl"],
}


def record(options, family, folder):
    """A take of the motion, and the number of the frame that it begins with."""
    take, line = folder / f"{family}.take", folder / "line"
    words = FAMILIES[family] or [f"--pty={line}"]
    simulator = subprocess.Popen([options.mocapd_sim, "serve", *MOTION, *words],
                                 stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        named = simulator.stdout.readline().strip()
        uri = f"serial:{line}" if family == "serial" else named
        command = [options.mocapd, "record", "-d", uri, "-o", take, "--lossless", "--json", "--seconds", "12s"]
        if family == "serial":
            time.sleep(0.5)
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    finally:
        simulator.terminate()
        simulator.wait(10)
    if done.returncode not in (0, 3) or not take.exists():
        raise SystemExit(f"{family}: {done.stderr}")
    report = json.loads(done.stdout)
    if not report["ledger"]["closes"] or report["ledger"]["recorded"] != report["ledger"]["frames_sent"]:
        raise SystemExit(f"{family}: frames are lost: {report['ledger']}")
    return take, N_FRAMES - report["frames"]


def diff(options, a, b):
    done = subprocess.run([options.mocapd, "diff", a, b, "--json"], capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise SystemExit(done.stderr)
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
        raise SystemExit(f"{take}: {motion}")
    if motion["max_distance_mm"] > UNITS_MM:
        raise SystemExit(f"{take}: {motion['max_distance_mm']} mm away")
    return motion, fields


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd", required=True, type=Path)
    parser.add_argument("--mocapd-sim", required=True, type=Path)
    options = parser.parse_args()
    options.mocapd, options.mocapd_sim = options.mocapd.resolve(), options.mocapd_sim.resolve()
    print("| through | frames | samples that differ from the serial line's | by at most | ticks of the clock | up axis |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        serial, skipped = record(options, "serial", folder)
        if skipped:
            raise SystemExit(f"serial: {skipped} frames are missing")
        for family in FAMILIES:
            if family == "serial":
                print(f"| serial | {N_FRAMES} | | | 10000000 Hz | z |")
                continue
            take, skipped = record(options, family, folder)
            motion, fields = compared(options, serial, take, skipped, folder)
            differing, samples = motion["samples_differing"], motion["samples"]
            tick_hz = fields.get("device.tick_hz", ("", "10000000"))[1]
            up = fields.get("up_axis", ("", "z"))[1]
            print(f"| {family} | {N_FRAMES - skipped} | {differing} of {samples} | {motion['max_distance_mm']:.5f} mm | {tick_hz} Hz | {up} |")
    sys.exit(0)


if __name__ == "__main__":
    main()
