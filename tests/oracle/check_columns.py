"""Exports every take of a folder as Parquet, long and wide, and as MCAP, and reads them with columns.py; analog channels
and force plates, of generated C3D files, too, are compared with ezc3d's (sampled.py).

    python check_columns.py --mocapd target/release/mocapd --takes DIR [--tolerances 0.5]

mocapd must have the feature `full`. One line for each file, format and reader; the last line is `N passed, N failed`;
exit code 1 when one failed.
"""

import argparse
import json
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

import columns
import compare
import generated
import readers
import sampled
from check_import import SUFFIXES, run

# What metres in float32 may add to a coordinate in millimetres.
METRES = 2e-7


def about(found, take, tolerance_mm):
    """What the metadata say wrongly."""
    complaints = []
    for name, expected in [
        ("mocapd.rate_hz", take.rate_hz),
        ("mocapd.tolerance_mm", tolerance_mm),
        ("mocapd.first_frame", take.first_frame),
        ("mocapd.frames", len(take.positions_mm)),
    ]:
        if not np.isclose(float(found.get(name, "nan")), expected, rtol=1e-6):
            complaints.append(f"{name} is {found.get(name)}, expected {expected}")
    ledger = json.loads(found.get("mocapd.ledger", "{}"))
    if not ledger.get("closes") or ledger["samples_present"] != int((~take.gaps).sum()):
        complaints.append("the ledger does not count the samples")
    return complaints


def check(mocapd, path, tolerance_mm):
    """One file at one tolerance: its lines, each with whether it passed."""
    lines = []

    def tell(what, complaints):
        name = f"{path.name} {tolerance_mm} mm {what}"
        lines.append((f"FAIL {name}: {'; '.join(complaints)}" if complaints else f"ok   {name}", not complaints))

    def attempt(what, work):
        try:
            tell(what, work())
        except Exception as problem:  # any failure is this reader's, the others still count
            tell(what, [f"{type(problem).__name__}: {problem}"])

    with tempfile.TemporaryDirectory() as folder:
        recorded, long, wide, mcap = (Path(folder) / name for name in ("t.take", "l.parquet", "w.parquet", "t.mcap"))
        try:
            take = readers.read(path)
            run(mocapd, "import", path, "-o", recorded, "--tolerance", f"{tolerance_mm}mm")
            run(mocapd, "export", recorded, "-o", long)
            run(mocapd, "export", recorded, "-o", wide, "--wide")
            run(mocapd, "export", recorded, "-o", mcap)
        except Exception as problem:
            tell("export", [f"{type(problem).__name__}: {problem}"])
            return lines
        for reader in columns.READERS:
            for layout, file, read in [("long", long, columns.read_long), ("wide", wide, columns.read_wide)]:
                attempt(
                    f"{layout}, {reader.__name__}",
                    lambda file=file, read=read, reader=reader: compare.compare_csv(
                        take, read(file, reader), tolerance_mm
                    )[0],
                )
        attempt("long, metadata", lambda: about(columns.metadata(long), take, tolerance_mm))
        attempt("wide, metadata", lambda: about(columns.metadata(wide), take, tolerance_mm))
        largest_mm = float(np.nanmax(np.abs(take.positions_mm), initial=1.0))
        loose_mm = tolerance_mm + METRES * largest_mm
        attempt("mcap", lambda: compare.compare_csv(take, columns.read_mcap(mcap), loose_mm)[0])
        tables, first = (sampled.expected(path) if take.oracle == "ezc3d" else {}), {}
        for what, file, read in [
            ("long", long, sampled.read_parquet),
            ("wide", wide, sampled.read_parquet),
            ("mcap", mcap, sampled.read_mcap),
        ]:
            attempt(
                f"{what}, analog and force plates",
                lambda file=file, read=read: sampled.complaints(tables, file, read, first),
            )
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd", required=True, type=Path)
    parser.add_argument("--takes", required=True, type=Path)
    parser.add_argument("--tolerances", default="0.5", help="millimetres, comma separated")
    arguments = parser.parse_args()
    settings = [float(tolerance) for tolerance in arguments.tolerances.split(",")]
    files = sorted(path for path in arguments.takes.iterdir() if path.suffix.lower() in SUFFIXES)
    passed = failed = 0
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(2) as pool:
        files += generated.sampled(Path(folder))
        jobs = [(arguments.mocapd.resolve(), path, tolerance) for path in files for tolerance in settings]
        for lines in pool.map(check, *zip(*jobs)) if jobs else []:
            for line, good in lines:
                print(line, flush=True)
                passed, failed = passed + good, failed + (not good)
    print(f"{passed} passed, {failed} failed")
    sys.exit(failed != 0 or passed == 0)


if __name__ == "__main__":
    main()
