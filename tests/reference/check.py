"""Decodes takes with mocapd and with the reference decoder, and compares them bit for bit.

    python tests/reference/check.py --mocapd target/release/mocapd TAKES_DIR [--all] [--jobs 2]
        [--tolerances 0.1,0.5,1,5,10,20] [--resamplers dense,fast,lossless] [--largest BYTES]
    python tests/reference/check.py

The golden takes of this format version (take/tests/golden) are decoded, and their digests are compared with
expected.txt. Without a folder of takes nothing else is done, and mocapd need not be built.

Every file of the folder is imported at 1 mm with `dense`; the two smallest ones also at every tolerance with every
live resampler, and at 5 mm with `spline` and `sync`. `--all` treats every file like the smallest ones (without
`spline` and `sync`, which are for short takes). --tolerances and --resamplers apply to every file. --largest leaves out
files of more bytes: Python decodes some 15 000 samples a second.
Takes (.take) in the folder, recordings for instance, are compared as they are.

The results of mocapd are its CSV export, which has the fewest digits that restore each float32, `info --json` for
the numbers of samples and kept samples of each channel, and SR1 for the rows in which samples were kept.

Prints one line per comparison, then `N passed, N failed`; the exit code is 1 if one failed.
"""

import argparse
import csv
import hashlib
import json
import struct
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from take.container import VERSIONS
from take.samples import NAN, POSES, parts, poses
from take.stretch import read_take

GOLDENS = Path(__file__).parents[2] / "take" / "tests" / "golden"
SUFFIXES = {".c3d", ".trc", ".tsv", ".csv"}
TOLERANCES_MM = [0.1, 0.5, 1.0, 5.0, 10.0, 20.0]
LIVE = ["dense", "fast", "lossless"]
OFFLINE = ["spline", "sync"]
BITS = struct.Struct("<3f")
SAMPLE, TIME = struct.Struct("<B3f"), struct.Struct("<3Q5B")


def run(*command):
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    if result.returncode not in (0, 3):  # 3: frames were lost when it was recorded
        raise RuntimeError(f"exit {result.returncode}: {result.stderr.strip()[-300:]}")
    return result.stdout


def compare_positions(take, path):
    """The first difference between the samples, or None."""
    with open(path, newline="", encoding="utf-8") as file:
        table = csv.reader(file)
        columns = (len(next(table)) - 2) // 3
        n_rows = 0
        for row, cells in enumerate(table):
            n_rows += 1
            for channel in range(columns):
                words = cells[2 + 3 * channel : 5 + 3 * channel]
                found = take.tracks.get(channel, {}).get(row)
                if words[0] == "":
                    if found:
                        return f"row {row} channel {channel}: a sample that mocapd does not have"
                elif not found:
                    return f"row {row} channel {channel}: mocapd has a sample"
                elif BITS.pack(*map(float, words)) != BITS.pack(*found[0]):
                    return f"row {row} channel {channel}: {found[0]}, mocapd has {words}"
    return None if n_rows == take.n_rows else f"{take.n_rows} rows, mocapd has {n_rows}"


def compare_counts(take, info):
    for i, channel in enumerate(info["channels"]):
        track = take.tracks.get(i, {}).values()
        counts = len(track), sum(kept for _, kept in track)
        if counts != (channel["samples"], channel["knots"]):
            return f"channel {i}: {counts} samples and kept ones, mocapd has {channel}"
    in_rows, kept_rows = {}, set()
    for track in take.tracks.values():
        for row, (_, kept) in track.items():
            in_rows[row] = in_rows.get(row, 0) + 1
            if kept:
                kept_rows.add(row)
    under = sum(in_rows[row] for row in kept_rows) + len(kept_rows)
    sr1 = (sum(in_rows.values()) + len(in_rows)) / under if under else None
    if sr1 != info["sr1"]:
        return f"SR1 {sr1}, mocapd has {info['sr1']}"
    if take.stated_mm != info["max_error_mm"]:
        return f"states {take.stated_mm} mm, mocapd has {info['max_error_mm']} mm"
    if (take.ending[0] if take.ending else None) != info["ending"]:
        return f"it ended: {take.ending}, mocapd has {info['ending']}"
    return None


def check(mocapd, path, resampler, tolerance_mm):
    """Checks one file and returns its output line and whether it passed."""
    name = f"{path.name} {resampler} {tolerance_mm} mm" if resampler else path.name
    try:
        with tempfile.TemporaryDirectory() as folder:
            recorded, table = Path(folder) / "t.take", Path(folder) / "t.csv"
            if resampler:
                command = [mocapd, "import", path, "-o", recorded, "--resampler", resampler]
                tolerance = [] if resampler.startswith("lossless") else ["--tolerance", f"{tolerance_mm}mm"]
                run(*command, *tolerance, "--drop-foreign", "--threads", "1")
            else:
                recorded = path
            run(mocapd, "export", recorded, "-o", table)
            info = json.loads(run(mocapd, "info", recorded, "--json"))
            start = time.perf_counter()
            take = read_take(recorded.read_bytes())
            seconds = time.perf_counter() - start
            complaint = compare_positions(take, table) or compare_counts(take, info)
    except Exception as problem:  # any failure belongs to this file, and the others still count
        return f"FAIL {name}: {type(problem).__name__}: {problem}", False
    if complaint:
        return f"FAIL {name}: {complaint}", False
    samples = sum(map(len, take.tracks.values()))
    kept = sum(kept for track in take.tracks.values() for _, kept in track.values())
    pace = seconds / max(samples, 1) * 1e6
    return f"ok   {name}: {samples} samples, {kept} kept, {pace:.0f} us a sample", True


def digest(parts):
    return hashlib.sha256(b"".join(parts)).hexdigest()[:16]


def golden_words(take):
    """The contents of expected.txt for a take, except what this decoder skips: stretches, events, ledgers."""
    markers = (f"{m['marker_id']} {m['label']} {int(m['labelled'])}\n".encode() for m in take.channels)
    yield f"rows {take.n_rows}, stated {take.stated_mm} mm"
    yield f"{len(take.channels)} markers, {digest(markers)}"
    for channel, track in sorted(take.tracks.items()):
        if track:
            kept = sum(kept for _, kept in track.values())
            rows = (track.get(row) for row in range(take.n_rows))
            samples = (SAMPLE.pack(1 | s[1] << 1, *s[0]) if s else bytes(SAMPLE.size) for s in rows)
            yield f"channel {channel}: {len(track)} samples, {kept} kept, {digest(samples)}"
    times = (
        TIME.pack(row, ticks, arrival, code is not None, *(code or (0, 0, 0, 0)))
        for row, ticks, arrival, code in take.times
    )
    yield f"times of {len(take.times)} rows, {digest(times)}"
    for row, n_rows, causes in take.lost:
        yield f"lost from row {row}: {n_rows}, causes {causes}"
    for group in take.groups:
        channels = (f"{name} {unit} {index} {scale!r} {offset!r}\n".encode() for name, unit, index, scale, offset in group.channels)
        yield (
            f"group {group.number} of {group.kind}: form {group.form}, from channel {group.first_channel} of {group.part_channels}, "
            f"{group.samples_per_frame} a frame, {group.rate_hz!r} Hz, from frame {group.first_frame}, "
            f"{group.n_samples} samples, {digest(channels)}{f', bounds {group.bounds}' if group.bounds else ''}"
        )
    recorded = [group for group in take.groups if group.kind in ("", POSES)]
    for group in recorded:
        samples = (NAN if bits is None else bits for samples in group.samples for bits in samples)
        words = (word.to_bytes(4, "little") for word in samples)
        yield f"samples of group {group.number}: {len(group.samples[0])}, {digest(words)}"
    for group in recorded:
        if group.kind == POSES:
            yield f"poses of group {group.number}: {digest(poses(group))}"
    for kind, data in parts([group for group in take.groups if group not in recorded], take.order):
        yield f"part {kind}: {len(data)} bytes, {digest([data])}"


def check_golden(path, words):
    """Checks one golden take and returns its output line and whether it passed."""
    passed_over = ("stretch ", "event ", "ledger ", "sample ledger", "rows of poses")
    expected = [line for line in words.splitlines() if line and not line.startswith(passed_over)]
    name = f"golden {path.name} of version {path.parent.name[1:]}"
    try:
        found = list(golden_words(read_take(path.read_bytes())))
    except Exception as problem:  # any failure belongs to this file, and the others still count
        return f"FAIL {name}: {type(problem).__name__}: {problem}", False
    if found != expected:
        differing = [line for line in expected if line not in found] or ["more than is expected"]
        return f"FAIL {name}: not {differing[0]}", False
    return f"ok   {name}: {len(found)} lines", True


def plan_goldens():
    """(file, expected contents)"""
    goldens = []
    for folder in (GOLDENS / f"v{version}" for version in VERSIONS):
        sections = (folder / "expected.txt").read_text(encoding="utf-8").split("\ntake ")[1:]
        pairs = (section.split("\n", 1) for section in sections)
        goldens += [(folder / name, words) for name, words in pairs]
    return goldens


def plan(files, arguments):
    """(file, resampler, tolerance), the slowest first."""
    named = arguments.tolerances or arguments.resamplers
    tolerances = arguments.tolerances or TOLERANCES_MM
    resamplers = arguments.resamplers or LIVE
    smallest = sorted(files, key=lambda path: path.stat().st_size)[:2]
    jobs = []
    for path in files:
        wide = named or arguments.all or path in smallest
        for resampler in resamplers if wide else ["dense"]:
            wanted = tolerances if wide else [1.0]
            jobs += [(path, resampler, mm) for mm in (wanted if not resampler.startswith("lossless") else [0.0])]
        if path in smallest and not named:
            jobs += [(path, resampler, 5.0) for resampler in OFFLINE]
    return sorted(jobs, key=lambda job: -job[0].stat().st_size)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("takes", nargs="?", type=Path, metavar="TAKES_DIR", help="without: golden takes only")
    parser.add_argument("--mocapd", type=lambda path: Path(path).resolve(), help="for the takes of TAKES_DIR")
    parser.add_argument("--tolerances", type=lambda t: [float(mm) for mm in t.split(",")], help="millimetres")
    parser.add_argument("--resamplers", type=lambda names: names.split(","))
    parser.add_argument("--all", action="store_true", help="every file at everything")
    parser.add_argument("--largest", type=int, default=sys.maxsize, metavar="BYTES", help="leave out larger files")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    if arguments.takes and not arguments.mocapd:
        parser.error("--mocapd is needed to compare with")
    everything = sorted(arguments.takes.iterdir()) if arguments.takes else []
    motion = [path for path in everything if path.suffix.lower() in SUFFIXES]
    files = [path for path in motion if path.stat().st_size <= arguments.largest]
    if len(files) < len(motion):
        print(f"left out: {len(motion) - len(files)} files of more than {arguments.largest} bytes")
    recordings = [(path, None, None) for path in everything if path.suffix == ".take"]
    jobs = recordings + plan(files, arguments)
    passed = failed = 0
    with ProcessPoolExecutor(arguments.jobs) as pool:
        goldens = [pool.submit(check_golden, *golden) for golden in plan_goldens()]
        others = [pool.submit(check, arguments.mocapd, *job) for job in jobs]
        for future in goldens + others:
            line, good = future.result()
            print(line, flush=True)
            passed, failed = passed + good, failed + (not good)
    print(f"{passed} passed, {failed} failed")
    sys.exit(failed > 0 or passed == 0)


if __name__ == "__main__":
    main()
