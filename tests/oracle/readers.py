"""Reads recorded takes without the project's code: ezc3d for C3D, parsers of its own for text.

A coordinate in millimetres is float32(float64(value as stored or printed) * factor).
A C3D sample is a gap where ezc3d says NaN (its fourth word is negative), where the fourth word is -1 written unsigned
(65535.0: the residual's byte is 255, which as a signed word cannot be), or where a coordinate is not finite.
Points that POINT:ANGLES, FORCES, MOMENTS, POWERS, SCALARS, REACTIONS or a list in POINT:TYPE_GROUPS other than
MODELED_MARKERS names are model outputs, not markers.
"""

import re
import struct
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

FACTORS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
MODEL_OUTPUTS = ["ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS"]


@dataclass
class Take:
    """What one file holds."""

    labels: list  # as found; "" where there is none
    rate_hz: float
    first_frame: int
    positions_mm: np.ndarray  # float32 (frames, markers, 3); NaN where missing
    factor: float
    marker_points: list  # C3D: index of each marker among the points
    oracle: str  # which reader the answer comes from

    @property
    def gaps(self):
        return np.isnan(self.positions_mm[:, :, 0])

    def names(self):
        """Labels with `u001`... by column where there is none."""
        return [label or f"u{column:03d}" for column, label in enumerate(self.labels, 1)]

    def csv_names(self):
        """Labels as CSV columns: repeated ones get #2, #3... in order, skipping names already used."""
        used, names = set(), []
        for label in self.names():
            name, number = label, 2
            while name in used:
                name, number = f"{label}#{number}", number + 1
            used.add(name)
            names.append(name)
        return names


def in_millimetres(values, factor):
    with np.errstate(over="ignore"):
        positions = (np.asarray(values, dtype=np.float64) * factor).astype(np.float32)
    positions[~np.isfinite(positions).all(axis=2)] = np.nan
    return positions


def read(path):
    path = Path(path)
    readers = {".c3d": read_c3d, ".trc": read_trc, ".tsv": read_tsv, ".csv": read_csv}
    return readers[path.suffix.lower()](path)


def strings(value):
    return [str(text).rstrip(" \0") for text in value]


def read_c3d(path):
    import ezc3d

    try:
        file = ezc3d.c3d(str(path))
    except Exception:
        return read_c3d_by_hand(path)
    point = file["parameters"]["POINT"]
    labels = strings(point["LABELS"]["value"])
    points = np.moveaxis(file["data"]["points"][:3], 0, 2).transpose(1, 0, 2).copy()
    residuals = file["data"]["meta_points"]["residuals"][0].T
    points[residuals >= 128 * abs(float(point["SCALE"]["value"][0]))] = np.nan
    outputs = set()
    groups = strings(point["TYPE_GROUPS"]["value"]) if "TYPE_GROUPS" in point else []
    for name in MODEL_OUTPUTS + [g for g in groups[::2] if "MARKER" not in g.upper()]:
        if name in point:
            outputs.update(strings(point[name]["value"]))
    outputs.discard("")
    labels = (labels + [""] * points.shape[1])[: points.shape[1]]
    markers = [i for i, label in enumerate(labels) if label not in outputs]
    unit = strings(point["UNITS"]["value"])[0] if "UNITS" in point else "mm"
    factor = FACTORS[unit.strip().lower()]
    rate = point["RATE"]["value"][0] if "RATE" in point and len(point["RATE"]["value"]) else 0.0
    return Take(
        labels=[labels[i] for i in markers],
        rate_hz=float(rate or file["header"]["points"]["frame_rate"]),
        first_frame=file["header"]["points"]["first_frame"] + 1,
        positions_mm=in_millimetres(points[:, markers], factor),
        factor=factor,
        marker_points=markers,
        oracle="ezc3d",
    )


def read_c3d_by_hand(path):
    """For a file that ezc3d and py-c3d refuse: Intel floats by the header alone, labels and unit by searching
    their parameters in the bytes."""
    data = path.read_bytes()
    n_points, n_analog, first, last = struct.unpack_from("<4H", data, 2)
    scale, block = struct.unpack_from("<fH", data, 12)
    (rate,) = struct.unpack_from("<f", data, 20)
    if data[(data[0] - 1) * 512 + 3] != 84 or scale >= 0:
        raise ValueError(f"{path}: only Intel floats are read by hand")

    def texts(name):
        at = data.index(bytes([len(name)]) + b"\x01" + name) + 2 + len(name) + 2
        kind, n_dimensions = data[at], data[at + 1]
        dimensions = data[at + 2 : at + 2 + n_dimensions]
        assert kind == 255, name
        start = at + 2 + n_dimensions
        count = dimensions[1] if n_dimensions > 1 else 1
        length = dimensions[0]
        return [
            data[start + i * length : start + (i + 1) * length].decode("latin-1").rstrip(" \0")
            for i in range(count)
        ]

    frame = 4 * n_points + n_analog
    words = np.frombuffer(data, "<f4", offset=(block - 1) * 512)[: frame * (last - first + 1)]
    words = words.reshape(-1, frame)[:, : 4 * n_points].reshape(-1, n_points, 4)
    positions = words[:, :, :3].astype(np.float64)
    positions[words[:, :, 3] < 0] = np.nan
    factor = FACTORS[texts(b"UNITS")[0].strip()]
    return Take(
        labels=texts(b"LABELS"),
        rate_hz=rate,
        first_frame=first,
        positions_mm=in_millimetres(positions, factor),
        factor=factor,
        marker_points=list(range(n_points)),
        oracle="bytes",
    )


def text_lines(path):
    text = path.read_bytes().decode("utf-8-sig", errors="replace")
    return [line.rstrip("\r") for line in text.split("\n")]


def rectangle(rows, factor, width):
    """Rows of cells -> positions; an empty or missing cell makes its sample a gap."""
    values = np.full((len(rows), width * 3), np.nan)
    for row, cells in zip(values, rows):
        for column, cell in enumerate(cells[: width * 3]):
            if cell.strip():
                row[column] = float(cell)
    return in_millimetres(values.reshape(len(rows), width, 3), factor)


def filled_triplets(cells):
    """Markers up to the last cell with something in it."""
    filled = [i for i, cell in enumerate(cells) if cell.strip()]
    return filled[-1] // 3 + 1 if filled else 0


def read_trc(path):
    lines = text_lines(path)
    values = dict(zip(lines[1].split("\t"), (v.strip() for v in lines[2].split("\t"))))
    labels = [cell.strip() for cell in lines[3].split("\t")[2::3]]
    while labels and not labels[-1]:
        labels.pop()
    rows = [line.split("\t") for line in lines[5:] if re.match(r"\s*\d+\t", line)]
    cells = [row[2:] for row in rows]
    width = max([len(labels)] + [filled_triplets(row) for row in cells])
    factor = FACTORS[values["Units"].lower()]
    return Take(
        labels=labels + [""] * (width - len(labels)),
        rate_hz=float(values["DataRate"]),
        first_frame=int(rows[0][0]),
        positions_mm=rectangle(cells, factor, width),
        factor=factor,
        marker_points=[],
        oracle="text",
    )


def read_tsv(path):
    lines = text_lines(path)
    start = next(i for i, line in enumerate(lines) if line.startswith("MARKER_NAMES"))
    header = dict(line.split("\t", 1) for line in lines[:start] if "\t" in line)
    labels = [cell.strip() for cell in lines[start].split("\t")[1:] if cell.strip()]
    cells = [line.split("\t") for line in lines[start + 1 :] if line.strip()]
    positions = rectangle(cells, 1.0, len(labels))
    positions[(positions == 0).all(axis=2)] = np.nan  # how QTM writes a missing sample
    return Take(labels, float(header["FREQUENCY"]), 1, positions, 1.0, [], "text")


def read_csv(path):
    lines = text_lines(path)
    values = dict(re.findall(r"(\w+)=(\S+)", lines[0])) if lines[0].startswith("#") else {}
    names, *rows = [line.split(",") for line in lines if line and not line.startswith("#")]
    labels = [re.sub("_x$", "", name) for name in names[1::3]]
    factor = FACTORS[values.get("units", "mm")]
    cells = [row[1:] for row in rows]
    return Take(labels, float(values["rate"]), 1, rectangle(cells, factor, len(labels)), factor, [], "text")


def read_export_csv(path):
    """What `mocapd export` writes: names, frame numbers, times, positions (float32, NaN where cells are empty)."""
    import csv

    with open(path, newline="", encoding="utf-8") as file:
        names, *rows = list(csv.reader(file))
    assert names[:2] == ["frame", "time_s"], names[:2]
    labels = []
    for x, y, z in zip(names[2::3], names[3::3], names[4::3], strict=True):
        assert (x[-2:], y[-2:], z[-2:]) == (".x", ".y", ".z") and x[:-2] == y[:-2] == z[:-2], (x, y, z)
        labels.append(x[:-2])
    frames = np.array([int(row[0]) for row in rows])
    times = np.array([float(row[1]) for row in rows])
    positions = rectangle([row[2:] for row in rows], 1.0, len(labels))
    return labels, frames, times, positions


def read_with_py_c3d(path):
    """Labels, rate, positions (float32, NaN where the residual is -1) by py-c3d."""
    import c3d

    with open(path, "rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of files without analog data
        reader = c3d.Reader(file)
        points = np.array([points for _, points, _ in reader.read_frames()], dtype=np.float32)
        labels = [str(label).rstrip() for label in reader.point_labels]
        rate = reader.point_rate
    points = points.reshape(len(points), -1, 5)
    positions = points[:, :, :3].copy()
    positions[points[:, :, 3] == -1] = np.nan
    return labels, rate, positions
