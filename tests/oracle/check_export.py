"""Imports takes with mocapd, exports them to every format, and has them read by programs that are not ours.

    python check_export.py --mocapd target/release/mocapd [--takes DIR]

Every take of the folder is imported once, at 1 mm; generated ones of odd sizes without loss. All formats must hold the
same bits, within the tolerance of the source. Events are put in by way of a TSV file, which is imported again.
All exports to BIDS are in one data set, too, of which the official validator, which takes a second to start, checks the whole.
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
from itertools import chain
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


def check_events(mocapd, recorded, take, folder, dataset, lines):
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
            add_to_dataset(mocapd, again, *dataset, "events")
        lines.append((not complaints, f"{kind} events {'; '.join(complaints)}"))


def add_to_dataset(mocapd, recorded, dataset, number, of_what="", *options):
    """Exports a take into the data set of all takes, as a subject of its own."""
    subject = ["--subject", f"{number}{of_what}", "--task", "jump"]
    run(mocapd, "export", recorded, "-o", dataset, "--format", "bids", *subject, *options)


def check_dataset(mocapd, recorded, dataset, number, lines):
    """Several subjects, sessions and runs in one BIDS data set."""
    recordings = [("first", "--run", "1"), ("first", "--run", "2"), ("second", "--session", "pre")]
    recordings.append(("second", "--session", "post", "--run", "01"))
    for words in recordings:
        add_to_dataset(mocapd, recorded, dataset, number, *words)
    complaints = []
    found = sum(len(list(dataset.glob(f"sub-{number}{name}/**/*_motion.tsv"))) for name in ("first", "second"))
    if found != len(recordings):
        complaints.append(f"{found} recordings for {len(recordings)}")
    participants = (dataset / "participants.tsv").read_text(encoding="utf-8").split()
    rows = [participants.count(f"sub-{number}{name}") for name in ("first", "second")]
    if participants[0] != "participant_id" or rows != [1, 1]:
        complaints.append(f"participants {participants}")
    lines.append((not complaints, f"bids of several recordings {'; '.join(complaints)}"))


def check(job):
    """One take: a line and whether it passed for each format, and, of a whole check, for its events and data set."""
    mocapd, source, take, is_whole, dataset, number = job
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
                    # One that is alone in its data set is checked alone, as well.
                    complaints += exports.validate_bids(path) if number == 0 else []
                    add_to_dataset(mocapd, recorded, dataset, number)
            except Exception as problem:  # any failure is this format's, the others still count
                complaints = [f"{type(problem).__name__}: {problem}"]
            lines.append((not complaints, f"{kind} {'; '.join(complaints)}"))
        if is_whole:
            events = folder / "events"
            events.mkdir()
            check_events(mocapd, recorded, take, events, (dataset, number), lines)
            check_dataset(mocapd, recorded, dataset, number, lines)
    except Exception as problem:
        lines.append((False, f"{type(problem).__name__}: {problem}"))
    finally:
        shutil.rmtree(folder)
    return [(good, f"{'ok  ' if good else 'FAIL'} {source.name} {words.strip()}"[:500]) for good, words in lines]


def check_all(dataset):
    """A line for what the validator finds in the data set of all takes; an iterator, so that it begins after them."""
    complaints = exports.validate_bids(dataset)
    yield not complaints, f"{'FAIL' if complaints else 'ok  '} bids of all takes {'; '.join(complaints)}"[:500]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd", required=True, type=Path)
    parser.add_argument("--takes", type=Path, help="recorded takes; without them only the generated ones")
    arguments = parser.parse_args()
    mocapd = arguments.mocapd.resolve()
    recorded = sorted(arguments.takes.iterdir()) if arguments.takes else []
    jobs = [(path, None, True) for path in recorded if path.suffix.lower() in SUFFIXES]
    passed = failed = 0
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(2) as pool:
        dataset = Path(folder) / "dataset"
        jobs += [(path, take, True) for path, take in generated.takes(Path(folder))]
        jobs += [(path, None, False) for path in generated.sampled(Path(folder))]
        jobs = [(mocapd, *job, dataset, number) for number, job in enumerate(jobs)]
        for lines in chain(pool.map(check, jobs), [check_all(dataset)]):
            for good, line in lines:
                print(line, flush=True)
                passed += good
                failed += not good
    print(f"{passed} passed, {failed} failed")
    sys.exit(failed > 0 or passed == 0)


if __name__ == "__main__":
    main()
