"""What (Shi et al. 2012) may have meant by the distance of step 3: SR2 by phase where the spline stops when the
largest distance of a sample is within the tolerance, and where the root of the mean square distance is.

    python readings.py --phases study/phases.csv FILES...

`phases.csv` is what `mocapd study --out` writes. Prints Markdown. docs/paper-study.md has its figures.
"""

import argparse
import csv
from collections import defaultdict
from pathlib import Path

import numpy as np
import readers
import spline

TOLERANCES_MM = [1.0, 5.0, 10.0, 15.0, 20.0]
READINGS = {"largest": np.max, "root mean square": np.mean}


def kept_counts(samples, measure):
    """Kept samples of one channel at each tolerance; None where there is a gap."""
    if not np.isfinite(samples).all():
        return None
    kept, counts, left = np.unique([0, len(samples) - 1]), [], list(reversed(TOLERANCES_MM))
    while left:
        errors = spline.squared_errors(samples, kept) if len(samples) > 2 else np.zeros(1)
        while left and np.sqrt(measure(errors)) <= left[0]:
            counts.append(len(kept))
            left.pop(0)
        if left:
            kept = np.unique(np.append(kept, errors.argmax()))
    return counts[::-1]


def read_phases(path):
    """By file name, each phase and its first frame."""
    phases = defaultdict(list)
    with open(path, newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            phases[row["file"]].append((row["phase"], int(row["first_frame"])))
    return phases


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("--phases", required=True, type=Path)
    parser.add_argument("files", nargs="+", type=Path)
    arguments = parser.parse_args()
    phases = read_phases(arguments.phases)
    items = defaultdict(int)
    kept = defaultdict(lambda: np.zeros(len(TOLERANCES_MM), dtype=int))
    names = []
    for path in arguments.files:
        positions = readers.read(path).positions_mm.astype(np.float64)
        starts = phases[path.name]
        ends = [first for _, first in starts[1:]] + [len(positions)]
        pieces = [(name, first, end) for (name, first), end in zip(starts, ends)]
        for name, first, end in pieces + [("whole", 0, len(positions))]:
            names += [name] if name not in names else []
            for marker in range(positions.shape[1]):
                samples = positions[first:end, marker]
                for reading, measure in READINGS.items():
                    counts = kept_counts(samples, measure)
                    if counts:
                        kept[name, reading] += counts
                        # A position a frame, and the marker's part of the time, which all share.
                        items[name, reading] += len(samples) * (1 + 1 / positions.shape[1])
    names.sort(key="whole".__eq__)
    for reading in READINGS:
        print(f"| {reading} | {' | '.join(names)} |\n|{'---|' * (len(names) + 1)}")
        for i, tolerance in enumerate(TOLERANCES_MM):
            cells = [f"{items[name, reading] / (2 * kept[name, reading][i]):.2f}" for name in names]
            print(f"| {tolerance:g} mm | {' | '.join(cells)} |")
        print()


if __name__ == "__main__":
    main()
