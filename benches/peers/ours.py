"""mocapd's side: runs `mocapd bench codec FILES --json` and turns its answer into rows like those of the peers."""

import json
import subprocess
from pathlib import Path

from bars import DENSE, FAST, SPLINE, cell
from sizes import TOLERANCES_MM
from takes import ROOT

# Below this a take's bytes are mostly its header and marker names, which no peer stores: blocks are compared instead.
WHOLE_FILE_RAW_BYTES = 1_000_000

BUILD_HINT = "no mocapd found: build it with `cargo build --release`, or name it with --mocapd PATH"


def find(path):
    """The named program, or the one built beside this folder."""
    program = Path(path) if path else ROOT / "target" / "release" / "mocapd"
    if not program.exists():
        raise FileNotFoundError(BUILD_HINT)
    return program


def run(program, path, resamplers=()):
    """The answer for one take; of all resamplers, or of some."""
    command = [str(program), "bench", "codec", str(path), "--json"]
    for resampler in resamplers:
        command += ["--resampler", resampler]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    if answer.returncode != 0:
        raise RuntimeError(f"mocapd bench codec failed: {answer.stderr.strip()}")
    return json.loads(answer.stdout)


def rows_of(answer, take):
    """The only place that knows the keys of mocapd's answer."""
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
            # The lossless resampler has no tolerance and stands beside the others at each.
            tolerances = [float(result["tolerance_mm"])] if result["tolerance_mm"] else TOLERANCES_MM
            rows += [row | {"tolerance_mm": tolerance} for tolerance in tolerances]
    return checked(rows, take)


def charged(raw_bytes, result):
    return result["bytes"] if raw_bytes >= WHOLE_FILE_RAW_BYTES else result["block_bytes"]


def checked(rows, take):
    """Refuses figures of another take or sample count, of a claim beyond its bound, and a dense that leaves cells out.

    A resampler that is in no claim may bound something else (a mean error): where it is beyond the tolerance it is
    left out, as its size would compare with nothing.
    """
    kept = []
    for row in rows:
        where = f"mocapd, {row['take']}, {row['resampler']}, {row['tolerance_mm']:g} mm"
        if row["samples"] != take.samples:
            raise AssertionError(f"{where}: {row['samples']} samples, {take.samples} read here")
        if row["max_error_mm"] <= row["tolerance_mm"]:
            kept.append(row)
        elif row["resampler"] in (DENSE, FAST, SPLINE):
            raise AssertionError(f"{where}: error {row['max_error_mm']} mm")
    dense = {cell(row) for row in kept if row["resampler"] == DENSE}
    missing = {(take.name, tolerance) for tolerance in TOLERANCES_MM} - dense
    if missing:
        raise AssertionError(f"mocapd reported no dense figures for {sorted(missing)}")
    return kept
