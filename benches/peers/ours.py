"""Runs `mocapd bench codec FILES --json` and converts its output to rows like those of the peers."""

import json
import subprocess
from pathlib import Path

from bars import DENSE, FAST, SPLINE, cell
from sizes import TOLERANCES_MM
from takes import ROOT

# A smaller take consists mostly of header and marker names, which no peer stores: only its blocks are compared.
WHOLE_FILE_RAW_BYTES = 1_000_000

BUILD_HINT = "mocapd not found: build it with `cargo build --release`, or give its path with --mocapd PATH"


def find(path):
    """The program at `path`, or the release build of this source tree."""
    program = Path(path) if path else ROOT / "target" / "release" / "mocapd"
    if not program.exists():
        raise FileNotFoundError(BUILD_HINT)
    return program


def run(program, path, resamplers=(), effort=1):
    """The parsed output for one take, with all resamplers or those given."""
    command = [str(program), "bench", "codec", str(path), "--json", "--effort", str(effort)]
    if effort > 1:
        # An exhaustive search takes minutes for a long take, and its speed is no claim.
        command += ["--repeats", "1"]
    for resampler in resamplers:
        command += ["--resampler", resampler]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    if answer.returncode != 0:
        raise RuntimeError(f"mocapd bench codec failed: {answer.stderr.strip()}")
    return json.loads(answer.stdout)


def rows_of(answer, take):
    """Rows from the output of mocapd; no other function depends on its keys."""
    rows = []
    for file in answer["files"]:
        for result in file["results"]:
            row = {
                "take": take.name,
                "samples": file["samples"],
                "raw_bytes": file["raw_bytes"],
                "filtered": take.filtered,
                "resampler": result["resampler"],
                "bytes": charged(file["raw_bytes"], result),
                "file_bytes": result["bytes"],
                "block_bytes": result["block_bytes"],
                "max_error_mm": result["max_error_mm"],
                "encode_mb_s": result["encode_mb_s"],
                "decode_mb_s": result["decode_mb_s"],
            }
            # The lossless resampler has no tolerance: its row is repeated for each.
            tolerances = [float(result["tolerance_mm"])] if result["tolerance_mm"] else TOLERANCES_MM
            rows += [row | {"tolerance_mm": tolerance} for tolerance in tolerances]
    return checked(rows, take)


def charged(raw_bytes, result):
    return result["bytes"] if raw_bytes >= WHOLE_FILE_RAW_BYTES else result["block_bytes"]


def checked(rows, take):
    """Fails for a different number of samples, an error beyond the bound in a claim, and missing cells of dense.

    A resampler without a claim may bound something else, such as the mean error. A row of it that exceeds the
    tolerance is left out, because its size is not comparable.
    """
    kept = []
    for row in rows:
        where = f"mocapd, {row['take']}, {row['resampler']}, {row['tolerance_mm']:g} mm"
        if row["samples"] != take.samples:
            raise AssertionError(f"{where}: {row['samples']} samples, expected {take.samples}")
        if row["max_error_mm"] <= row["tolerance_mm"]:
            kept.append(row)
        elif row["resampler"] in (DENSE, FAST, SPLINE):
            raise AssertionError(f"{where}: the error of {row['max_error_mm']} mm exceeds the tolerance")
    dense = {cell(row) for row in kept if row["resampler"] == DENSE}
    missing = {(take.name, tolerance) for tolerance in TOLERANCES_MM} - dense
    if missing:
        raise AssertionError(f"mocapd reported no dense figures for {sorted(missing)}")
    return kept
