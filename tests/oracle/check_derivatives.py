"""Compares the errors of velocities and accelerations that `mocapd verify --cutoff` tells with SciPy's.

    python check_derivatives.py --mocapd target/release/mocapd --mocapd-sim target/release/mocapd-sim [--takes DIR]

The take and its original are exported as CSV, filtered with scipy.signal.butter and filtfilt, and differentiated
here. One line for each file, cutoff and tolerance; the last line is `N passed, N failed`; exit code 1 when one failed.
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy
from scipy import signal

# Both passes together have half the power at the cutoff: Winter 2009, section 3.4.4.2.
TWO_PASSES = (math.sqrt(2) - 1) ** 0.25
CASES = [("0.5mm", 6.0), ("5mm", 6.0), ("1mm", 12.0)]
RECORDED = ["cmu_13_32_forward_jump_15joints_120hz.csv", "rolling_68m_175hz_gaps.c3d", "gait_active_22m_200hz_gaps.c3d"]
FIELDS = ["velocity_rms_mm_s", "velocity_max_mm_s", "acceleration_rms_mm_s2", "acceleration_max_mm_s2"]


def run(*words):
    result = subprocess.run([str(word) for word in words], capture_output=True, text=True)
    if result.returncode != 0:
        raise RuntimeError(f"{words[1]}: exit {result.returncode}: {result.stderr.strip()[-300:]}")
    return result.stdout


def read_csv(path):
    """Frames x markers x 3, NaN where there is a gap."""
    table = numpy.genfromtxt(path, delimiter=",", skip_header=1)
    # The shortest digits that bring back a float32 are not its value: it has to be brought back.
    return table[:, 2:].astype(numpy.float32).astype(numpy.float64).reshape(len(table), -1, 3)


def runs(present):
    edges = numpy.flatnonzero(numpy.diff(numpy.concatenate(([0], present.astype(int), [0]))))
    return zip(edges[::2], edges[1::2])


def errors(ours, theirs, rate_hz, cutoff_hz):
    """Of one marker: the four figures, by SciPy."""
    design_hz = rate_hz / math.pi * math.atan(math.tan(math.pi * cutoff_hz / rate_hz) / TWO_PASSES)
    b, a = signal.butter(2, design_hz, fs=rate_hz)
    period = math.ceil(rate_hz / cutoff_hz)
    velocities, accelerations = [], []
    for first, end in runs(numpy.isfinite(ours[:, 0]) & numpy.isfinite(theirs[:, 0])):
        if end - first < max(period, 4):
            continue
        padding = min(max(9, period), end - first - 1)
        smooth = [signal.filtfilt(b, a, x[first:end], axis=0, padlen=padding) for x in (ours, theirs)]
        speed = [(s[2:] - s[:-2]) * rate_hz / 2 for s in smooth]
        bend = [(s[2:] - 2 * s[1:-1] + s[:-2]) * rate_hz**2 for s in smooth]
        velocities.append(numpy.linalg.norm(speed[0] - speed[1], axis=1))
        accelerations.append(numpy.linalg.norm(bend[0] - bend[1], axis=1))
    figures = []
    for found in velocities, accelerations:
        lengths = numpy.concatenate(found) if found else numpy.zeros(1)
        figures += [math.sqrt(numpy.mean(lengths**2)), lengths.max()]
    return figures


def check(mocapd, path, tolerance, cutoff_hz, folder):
    """What is wrong with one file, or nothing."""
    take, lossless = folder / "t.take", folder / "l.take"
    files = [take, lossless, folder / "t.csv", folder / "l.csv"]
    try:
        run(mocapd, "import", path, "-o", take, "--tolerance", tolerance, "--drop-foreign")
        run(mocapd, "import", path, "-o", lossless, "--lossless", "--drop-foreign")
        run(mocapd, "export", take, "-o", files[2])
        run(mocapd, "export", lossless, "-o", files[3])
        report = json.loads(run(mocapd, "verify", take, "--against", path, "--cutoff", cutoff_hz, "--json"))
        rate_hz = json.loads(run(mocapd, "info", take, "--json"))["rate_hz"]
        ours, theirs = read_csv(files[2]), read_csv(files[3])
    finally:
        for file in files:
            file.unlink(missing_ok=True)
    markers = report["derivatives"]["markers"]
    if len(markers) != ours.shape[1]:
        return f"{len(markers)} markers for {ours.shape[1]}"
    for i, marker in enumerate(markers):
        expected = errors(ours[:, i], theirs[:, i], rate_hz, cutoff_hz)
        for field, value in zip(FIELDS, expected):
            # Filtering first and subtracting after costs digits: positions are thousands, errors thousandths.
            if abs(marker[field] - value) > 1e-6 * abs(value) + 1e-6:
                return f"{marker['label']}: {field} is {marker[field]}, SciPy has {value}"
    return None


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd", required=True)
    parser.add_argument("--mocapd-sim", required=True)
    parser.add_argument("--takes", type=Path)
    arguments = parser.parse_args()
    passed = failed = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        jumps = folder / "jumps"
        run(arguments.mocapd_sim, "generate", "--subjects", "2", "--jumps", "2", "--rate", "120", "--out", jumps)
        files = sorted(jumps.glob("*.c3d"))
        if arguments.takes:
            files += [arguments.takes / take for take in RECORDED]
        for path in files:
            for tolerance, cutoff_hz in CASES:
                try:
                    wrong = check(arguments.mocapd, path, tolerance, cutoff_hz, folder)
                except Exception as problem:  # any failure is this file's, the others still count
                    wrong = f"{type(problem).__name__}: {problem}"
                print(f"{'FAIL' if wrong else 'ok  '} {path.name} {tolerance} {cutoff_hz:g} Hz {wrong or ''}".rstrip())
                passed, failed = passed + (not wrong), failed + bool(wrong)
    print(f"{passed} passed, {failed} failed")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
