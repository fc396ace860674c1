"""A TRC file as OpenSim's TRCFileAdapter reads it (opensim-core, OpenSim/Common, 4.5): what that refuses is refused."""

from pathlib import Path

import numpy as np

KEYS = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"]


class Refused(Exception):
    """What OpenSim would throw."""


def tokens(line):
    """Cells between tabs, trimmed; behind the last tab there is one only when it is not empty."""
    cells = [cell.strip() for cell in line.rstrip("\r").split("\t")]
    if cells[-1] == "" and (line.rstrip("\r") == "" or line.rstrip("\r").endswith("\t")):
        cells.pop()
    return cells


def filled(cells):
    return [cell for cell in cells if cell]


def need(condition, message):
    if not condition:
        raise Refused(message)


def next_line(lines):
    """The next line that has a cell."""
    for line in lines:
        cells = tokens(line)
        if cells:
            return cells
    return []


def read(path):
    """Metadata, labels, numbers of the frames, times, positions as in the file (float64; NaN where a cell is empty)."""
    lines = iter(Path(path).read_text(encoding="utf-8").split("\n"))
    header = next(lines).replace("\t", " ").split()
    need(header and header[0] == "PathFileType", f"header {header[:1]}")
    keys = filled(next_line(lines))
    need(keys == KEYS, f"metadata keys {keys}")
    values = filled(next_line(lines))
    need(len(values) == len(keys), f"{len(values)} metadata values")
    metadata = dict(zip(keys, values))
    n_markers = int(metadata["NumMarkers"])
    labels = filled(next_line(lines))
    need(len(labels) == n_markers + 2, f"{len(labels)} column labels for {n_markers} markers")
    need(labels[:2] == ["Frame#", "Time"], f"column labels {labels[:2]}")
    labels = labels[2:]
    need(len(set(labels)) == len(labels), "column labels come twice")
    axes = filled(next_line(lines))
    expected = [f"{axis}{number}" for number in range(1, n_markers + 1) for axis in "XYZ"]
    need(axes[: len(expected)] == expected, f"axes {axes[:3]}...")
    row = next_line(lines)
    while row and not row[0]:
        row = next_line(lines)
    numbers, times, rows = [], [], []
    while row:
        need(len(row) == 3 * n_markers + 2, f"row {len(rows) + 1} has {len(row)} cells")
        numbers.append(int(row[0]))
        times.append(float(row[1]))
        cells = np.array([cell or "nan" for cell in row[2:]]).astype(float).reshape(n_markers, 3)
        cells[np.isnan(cells).any(axis=1)] = np.nan
        rows.append(cells)
        row = next_line(lines)
    need(int(metadata["NumFrames"]) == len(rows), f"NumFrames {metadata['NumFrames']}, {len(rows)} rows")
    positions = np.array(rows).reshape(len(rows), n_markers, 3)
    return metadata, labels, np.array(numbers), np.array(times), positions
