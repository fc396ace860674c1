"""Compares mocapd's spline resampler with spline.py, knot count by knot count.

    python check_spline.py --mocapd target/release/mocapd --takes DIR

Every CMU take with `spline:worst-sample`, those at 60 Hz also with `spline:exhaustive`, at 1, 5, 10 and 20 mm.
One line for each; the last line is `N passed, N failed`; exit code 1 when one failed.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import readers
import spline

TOLERANCES_MM = [1.0, 5.0, 10.0, 20.0]


def info(mocapd, path, variant, tolerance_mm):
    with tempfile.TemporaryDirectory() as folder:
        recorded = Path(folder) / "t.take"
        command = [mocapd, "import", path, "-o", recorded, "--resampler", f"spline:{variant}"]
        for words in [command + ["--tolerance", f"{tolerance_mm}mm"], [mocapd, "info", recorded, "--json"]]:
            result = subprocess.run([str(word) for word in words], capture_output=True, text=True)
            if result.returncode != 0:
                raise RuntimeError(f"exit {result.returncode}: {result.stderr.strip()[-300:]}")
    return json.loads(result.stdout)


def check(mocapd, path, variant):
    """One file and variant at all tolerances: lines, and how many passed."""
    take = readers.read(path)
    channels = [
        spline.resample(take.positions_mm[:, marker], TOLERANCES_MM, variant == "exhaustive")
        for marker in range(len(take.labels))
    ]
    lines, passed = [], 0
    for tolerance in TOLERANCES_MM:
        kept = [channel[tolerance] for channel in channels]
        counts = [len(times) for times in kept]
        sr1, sr2 = spline.storage_ratios(take.positions_mm, kept)
        name = f"{path.name} {variant} {tolerance:g} mm"
        try:
            found = info(mocapd, path, variant, tolerance)
            found_counts = [channel["knots"] for channel in found["channels"]]
            found_ratios = found["sr1"], found["sr2"]
        except Exception as problem:  # any failure is this take's, the others still count
            lines.append(f"FAIL {name}: {type(problem).__name__}: {problem}")
            continue
        wrong = [
            f"{label} {there} for {here}"
            for label, there, here in zip(take.labels, found_counts, counts)
            if there != here
        ]
        good = len(found_counts) == len(counts) and not wrong
        good &= all(abs(a - b) <= 1e-9 * b for a, b in zip(found_ratios, (sr1, sr2)))
        passed += good
        detail = f"{sum(counts)} knots, SR1 {sr1:.6f}, SR2 {sr2:.6f}"
        if not good:
            detail += f"; mocapd {sum(found_counts)} knots, SR1 {found_ratios[0]}, SR2 {found_ratios[1]}; {wrong[:4]}"
        lines.append(f"{'ok  ' if good else 'FAIL'} {name}: {detail}")
    return lines, passed


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd", required=True, type=Path)
    parser.add_argument("--takes", required=True, type=Path)
    parser.add_argument("--exhaustive-takes", type=int, help="of the 60 Hz takes only so many (a minute of a core each)")
    arguments = parser.parse_args()
    files = sorted(arguments.takes.glob("cmu_*.csv"))
    jobs = [(path, "worst-sample") for path in files]
    exhaustive = [path for path in files if path.stem.endswith("_60hz")]
    jobs += [(path, "exhaustive") for path in exhaustive[: arguments.exhaustive_takes]]
    passed = total = 0
    with ProcessPoolExecutor(2) as pool:
        results = pool.map(check, [arguments.mocapd.resolve()] * len(jobs), *zip(*jobs)) if jobs else []
        for lines, good in results:
            print("\n".join(lines), flush=True)
            passed, total = passed + good, total + len(lines)
    print(f"{passed} passed, {total - passed} failed")
    sys.exit(passed != total or not total)


if __name__ == "__main__":
    main()
