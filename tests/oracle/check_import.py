"""Imports every take of a folder with mocapd, exports it, and compares with readers.py.

    python check_import.py --mocapd target/release/mocapd --takes DIR [--tolerances 0.1,0.5,5,20] [--lossless]

One line for each file and tolerance; the last line is `N passed, N failed`; exit code 1 when one failed.
"""

import argparse
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import compare
import readers

SUFFIXES = {".c3d", ".trc", ".tsv", ".csv"}


def run(*command):
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    if result.returncode != 0:
        raise RuntimeError(f"exit {result.returncode}: {result.stderr.strip()[-300:]}")


def check(mocapd, path, tolerance_mm):
    """One file at one tolerance (None: lossless): its line, and whether it passed."""
    name = f"{path.name} {'lossless' if tolerance_mm is None else f'{tolerance_mm} mm'}"
    try:
        take = readers.read(path)
        with tempfile.TemporaryDirectory() as folder:
            recorded, table, binary = (Path(folder) / f"t.{end}" for end in ("take", "csv", "c3d"))
            precision = ["--lossless"] if tolerance_mm is None else ["--tolerance", f"{tolerance_mm}mm"]
            run(mocapd, "import", path, "-o", recorded, *precision)
            run(mocapd, "export", recorded, "-o", table)
            export = readers.read_export_csv(table)
            complaints, error = compare.compare_csv(take, export, tolerance_mm)
            run(mocapd, "export", recorded, "-o", binary)
            complaints += compare.compare_c3d(take, export[3], binary)
            if path.suffix.lower() == ".c3d" and take.oracle == "ezc3d":
                complaints += compare.compare_given_back(take, path, binary)
            size = recorded.stat().st_size
    except Exception as problem:  # any failure is this file's, the others still count
        return f"FAIL {name}: {type(problem).__name__}: {problem}", False
    if complaints:
        return f"FAIL {name}: {'; '.join(complaints)}", False
    present = int((~take.gaps).sum())
    return f"ok   {name}: {present} samples, {size} bytes, error {error:.6g} mm, by {take.oracle}", True


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd", required=True, type=Path)
    parser.add_argument("--takes", required=True, type=Path)
    parser.add_argument("--tolerances", default="0.1,0.5,5,20", help="millimetres, comma separated; may be empty")
    parser.add_argument("--lossless", action="store_true", help="also without loss")
    arguments = parser.parse_args()
    settings = [float(t) for t in arguments.tolerances.split(",") if t] + [None] * arguments.lossless
    files = sorted(path for path in arguments.takes.iterdir() if path.suffix.lower() in SUFFIXES)
    jobs = [(arguments.mocapd.resolve(), path, tolerance) for path in files for tolerance in settings]
    passed = 0
    with ProcessPoolExecutor(2) as pool:
        for line, good in pool.map(check, *zip(*jobs)) if jobs else []:
            print(line, flush=True)
            passed += good
    print(f"{passed} passed, {len(jobs) - passed} failed")
    sys.exit(passed != len(jobs) or not jobs)


if __name__ == "__main__":
    main()
