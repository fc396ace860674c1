"""Imports takes with mocapd, exports them to every format, and has them read by programs that are not ours.

    python check_export.py --mocapd target/release/mocapd [--takes DIR]

Every take of the folder is imported once, at 1 mm; generated ones of odd sizes without loss. All formats must hold the
same bits, within the tolerance of the source. Events are put in by way of a TSV file, which is imported again.
Analog channels, force plates, residuals and camera masks of C3D files, recorded and generated ones, must be those that
ezc3d reads (sampled.py).
One line for each take and format; the last line is `N passed, N failed`; exit code 1 when one failed.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

import compare
import exports
import generated
import readers
import sampled

TOLERANCE_MM = 1.0
SUFFIXES = {".c3d", ".trc", ".tsv", ".csv"}
FORMATS = ["npz", "c3d", "trc", "tsv", "csv", "long.csv", "xdf", "bids"]
HOLD_EVENTS = {"npz", "c3d", "tsv", "xdf", "bids"}
HOLD_SAMPLES = {"npz": sampled.read_npz, "csv": sampled.read_csv, "xdf": sampled.read_xdf, "bids": sampled.read_bids}


def run(*command):
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    if result.returncode != 0:
        raise RuntimeError(f"exit {result.returncode}: {result.stderr.strip()[-300:]}")
    return result.stderr


def export(mocapd, take, kind, folder):
    """Where the take was written to, and what was said of it."""
    path = folder / f"{take.stem}.{kind}"
    options = {"bids": ["--format", "bids"], "long.csv": ["--layout", "long"]}.get(kind, [])
    return path, run(mocapd, "export", take, "-o", path, *options)


def read(kind, path, take):
    """What a reader of that format finds; for C3D, which has two of its own, the events alone."""
    if kind == "long.csv":
        return exports.read_long(path, (take.first_frame, len(take.positions_mm), take.csv_names()))
    return getattr(exports, f"read_{kind}")(path)


def complaints_of(kind, found, take, base):
    """What differs from the source, or to the bit from what the first format held."""
    wrong = []
    expected = take.names() if kind == "npz" else take.csv_names()
    if found.labels != expected:
        pairs = [(a, b) for a, b in zip(found.labels, expected) if a != b][:3]
        wrong.append(f"labels differ: {len(found.labels)} for {len(expected)}, {pairs}")
    if kind in ("tsv", "trc"):
        # Three zeros mean a missing sample there, or may: one at the origin is written a nanometre beside it.
        base = base.copy()
        base[(base == 0).all(axis=2)] = [1e-6, 0, 0]
    if not compare.same_bits(np.ascontiguousarray(found.positions_mm), base):
        wrong.append("not the same bits")
    if found.rate_hz is not None and not np.isclose(found.rate_hz, take.rate_hz, rtol=1e-9):
        wrong.append(f"rate {found.rate_hz}")
    times = np.arange(len(take.positions_mm)) / take.rate_hz
    if found.times_s is not None and not np.allclose(found.times_s, times, rtol=1e-6, atol=1e-6):
        wrong.append("times do not follow the rate")
    if found.first_frame not in (None, take.first_frame):
        wrong.append(f"first frame {found.first_frame}, expected {take.first_frame}")
    return wrong


def complaints_of_events(found, expected, within_s):
    """Events of the same words at the same times."""
    near = lambda a, b: abs(a[0] - b[0]) < within_s and a[1] == b[1]
    same = len(found) == len(expected) and all(map(near, found, expected))
    return [] if same else [f"events {found} for {expected}"]


def check_source(take, positions, lossless):
    """The first format against the source."""
    if positions.shape != take.positions_mm.shape:
        return [f"shape {positions.shape}, expected {take.positions_mm.shape}"]
    if lossless:
        return [] if compare.same_bits(positions, take.positions_mm) else ["not bit-equal to the source"]
    wrong = int((np.isnan(positions).any(axis=2) != take.gaps).sum())
    difference = positions.astype(np.float64) - take.positions_mm.astype(np.float64)
    error = float(np.nanmax(np.sqrt((difference**2).sum(axis=2)), initial=0.0))
    complaints = [f"{wrong} gaps differ"] if wrong else []
    if error > TOLERANCE_MM + compare.rounding_mm(take):
        complaints.append(f"largest error {error} mm")
    return complaints


def check_events(mocapd, recorded, take, folder, lines):
    """Three events, put into a TSV file that is imported again, must come out of every format that holds any."""
    path, _ = export(mocapd, recorded, "tsv", folder)
    n_frames = len(take.positions_mm)
    frames = sorted({0, n_frames // 2, n_frames - 1})
    events = [(frame / take.rate_hz, f"event <{number}> é") for number, frame in enumerate(frames)]
    text = path.read_text(encoding="utf-8").split("\n")
    text = [line for line in text if not line.startswith("EVENT\t")]
    at = next(i for i, line in enumerate(text) if line.startswith("MARKER_NAMES"))
    text[at:at] = [f"EVENT\t{label}\t{frame + take.first_frame}\t{frame / take.rate_hz}" for frame, (_, label) in zip(frames, events)]
    path.write_text("\n".join(text), encoding="utf-8")
    folder = folder / "again"
    folder.mkdir()
    again = folder / "marked.take"
    run(mocapd, "import", path, "-o", again, "--lossless")
    for kind in FORMATS:
        path, said = export(mocapd, again, kind, folder)
        if kind not in HOLD_EVENTS:
            good = f"{len(events)} event" in said
            lines.append((good, f"{kind} says that it holds no events"))
            continue
        found = exports.c3d_events(path) if kind == "c3d" else read(kind, path, take).events
        complaints = complaints_of_events(found, events, 1e-4)
        if kind == "bids":
            complaints += exports.validate_bids(path)
        lines.append((not complaints, f"{kind} events {'; '.join(complaints)}"))


def check_dataset(mocapd, recorded, folder, lines):
    """Several subjects, sessions and runs in one BIDS data set, which stays valid."""
    dataset = folder / "study"
    recordings = [("01", None, "1"), ("01", None, "2"), ("02", "pre", None), ("02", "post", "01")]
    for subject, session, run_number in recordings:
        labels = ["--subject", subject, "--task", "jump"]
        labels += ["--session", session] if session else []
        labels += ["--run", run_number] if run_number else []
        run(mocapd, "export", recorded, "-o", dataset, "--format", "bids", *labels)
    complaints = exports.validate_bids(dataset)
    found = len(list(dataset.glob("sub-*/**/*_motion.tsv")))
    if found != len(recordings):
        complaints.append(f"{found} recordings for {len(recordings)}")
    participants = (dataset / "participants.tsv").read_text(encoding="utf-8").split()
    if participants != ["participant_id", "sub-01", "sub-02"]:
        complaints.append(f"participants {participants}")
    lines.append((not complaints, f"bids of several recordings {'; '.join(complaints)}"))


def check(job):
    """One take: a line and whether it passed for each format, and, of a whole check, for its events and data set."""
    mocapd, source, take, is_whole = job
    lossless = take is not None
    lines = []
    folder = Path(tempfile.mkdtemp())
    try:
        take = take or readers.read(source)
        recorded = folder / "t.take"
        precision = ["--lossless"] if lossless else ["--tolerance", f"{TOLERANCE_MM}mm"]
        run(mocapd, "import", source, "-o", recorded, *precision)
        base = None
        is_c3d = take.oracle == "ezc3d"
        own_events = exports.c3d_events(source) if is_c3d else []
        tables, first_tables = (sampled.expected(source) if is_c3d else {}), {}
        for kind in FORMATS:
            try:
                path, _ = export(mocapd, recorded, kind, folder)
                if kind == "c3d":
                    complaints = compare.compare_c3d(take, base, path)
                    complaints += complaints_of_events(exports.c3d_events(path), own_events, 1e-4)
                    complaints += compare.compare_given_back(take, source, path) if is_c3d else []
                else:
                    found = read(kind, path, take)
                    if base is None:
                        base = found.positions_mm
                        complaints = check_source(take, base, lossless)
                    else:
                        complaints = []
                    complaints += complaints_of(kind, found, take, base)
                    if kind in HOLD_EVENTS:
                        complaints += complaints_of_events(found.events, own_events, 0.51 / take.rate_hz)
                if kind in HOLD_SAMPLES:
                    complaints += sampled.complaints(tables, path, HOLD_SAMPLES[kind], first_tables)
                if kind == "bids":
                    complaints += exports.validate_bids(path)
            except Exception as problem:  # any failure is this format's, the others still count
                complaints = [f"{type(problem).__name__}: {problem}"]
            lines.append((not complaints, f"{kind} {'; '.join(complaints)}"))
        if is_whole:
            events = folder / "events"
            events.mkdir()
            check_events(mocapd, recorded, take, events, lines)
            check_dataset(mocapd, recorded, folder, lines)
    except Exception as problem:
        lines.append((False, f"{type(problem).__name__}: {problem}"))
    finally:
        shutil.rmtree(folder)
    return [(good, f"{'ok  ' if good else 'FAIL'} {source.name} {words.strip()}"[:500]) for good, words in lines]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd", required=True, type=Path)
    parser.add_argument("--takes", type=Path, help="recorded takes; without them only the generated ones")
    arguments = parser.parse_args()
    mocapd = arguments.mocapd.resolve()
    recorded = sorted(arguments.takes.iterdir()) if arguments.takes else []
    jobs = [(mocapd, path, None, True) for path in recorded if path.suffix.lower() in SUFFIXES]
    passed = failed = 0
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(2) as pool:
        jobs += [(mocapd, path, take, True) for path, take in generated.takes(Path(folder))]
        jobs += [(mocapd, path, None, False) for path in generated.sampled(Path(folder))]
        for lines in pool.map(check, jobs):
            for good, line in lines:
                print(line, flush=True)
                passed += good
                failed += not good
    print(f"{passed} passed, {failed} failed")
    sys.exit(failed > 0 or passed == 0)


if __name__ == "__main__":
    main()
