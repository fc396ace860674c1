#!/usr/bin/env python3
"""Puts two force plates under a generated jump: one where it begins, one where it ends.

    python3 force_plates.py jump.csv phases.csv jump-on-plates.c3d

jump.csv: the export of a jump of `mocapd-sim generate`; phases.csv: that of the same data set. The frames up to the first
step of the walk are written. The load is what the plates would measure of the markers' motion: m (a + g) of the centre of
mass at the middle between the ankles, and none in flight. The body has 75 kg, in segments by the fractions of Dempster as
printed in Winter, "Biomechanics and Motor Control of Human Movement", 4th ed. 2009, table 4.1.
"""

import csv
import struct
import sys

MASS_KG, GRAVITY_M_S2, RATIO = 75.0, 9.81, 10
# Fraction of the mass, the ends of the segment, and where between them its centre of mass is.
SEGMENTS = [(0.578, "pelvis", "throat", 0.66)] + [
    (fraction, f"{side}_{start}", f"{side}_{end}", at)
    for side in "lr"
    for fraction, start, end, at in [
        (0.100, "hip", "knee", 0.433), (0.061, "knee", "ankle", 0.606),
        (0.028, "shoulder", "elbow", 0.436), (0.022, "elbow", "wrist", 0.682),
    ]
]
# The surface of a plate is level, its x is the laboratory's, y and z point to the right and down.
PLATES = {1: (100.0, 0.0), 2: (2350.0, 0.0)}
HALF_MM = (400.0, 300.0)
CHANNELS = ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]


def smooth(values, half):
    """The mean of up to 2 half + 1 neighbours: what markers tell about accelerations is below some 15 Hz."""
    around = lambda i: values[max(0, i - half) : i + half + 1]
    return [sum(around(i)) / len(around(i)) for i in range(len(values))]


def main():
    table, phases, output = sys.argv[1:]
    with open(phases, newline="") as file:
        first = {row["phase"]: int(row["first_frame"]) for row in csv.DictReader(file)}
    with open(table, newline="") as file:
        rows = [{name: float(cell) for name, cell in row.items()} for row in csv.DictReader(file)][: first["walking"]]
    labels = [name[:-2] for name in rows[0] if name.endswith(".x")]
    n, rate_hz = len(rows), round(1 / (rows[1]["time_s"] - rows[0]["time_s"]), 6)
    flight, landing = first["flight-landing"], first["settling"]
    force, middle = [], []
    for axis in "xyz":
        total = sum(fraction for fraction, *_ in SEGMENTS)
        centre = [
            sum(f * (row[f"{a}.{axis}"] * (1 - at) + row[f"{b}.{axis}"] * at) for f, a, b, at in SEGMENTS) / total
            for row in rows
        ]
        centre = smooth(smooth(centre, 3), 2)
        bend = [centre[i - 1] - 2 * centre[i] + centre[i + 1] for i in range(1, n - 1)]
        acceleration = [b * rate_hz**2 / 1000 for b in [bend[0], *bend, bend[-1]]]
        force.append([MASS_KG * (a + (GRAVITY_M_S2 if axis == "z" else 0)) for a in acceleration])
        middle.append([(row[f"l_ankle.{axis}"] + row[f"r_ankle.{axis}"]) / 2 for row in rows])
    samples = []
    for number, (x, y) in PLATES.items():
        is_on = (lambda i: i < flight) if number == 1 else (lambda i: i >= landing)
        loads = []
        for i in range(n):
            fx, fy, fz = (force[0][i], -force[1][i], -max(force[2][i], 0.0)) if is_on(i) else (0.0, 0.0, 0.0)
            px, py = middle[0][i] - x, -(middle[1][i] - y)
            loads.append([fx, fy, fz, py * fz, -px * fz, px * fy - py * fx])
        samples.append(loads)
    write(output, rows, labels, rate_hz, samples)


def write(output, rows, labels, rate_hz, samples):
    """A C3D file of floats; between two frames the loads are interpolated."""
    n, n_channels = len(rows), len(PLATES) * 6

    def record(group, name, kind, dimensions, data):
        body = struct.pack("bB", kind, len(dimensions)) + bytes(dimensions) + data + b"\0"
        return struct.pack("bb", len(name), group) + name.encode() + struct.pack("<H", len(body) + 2) + body

    group = lambda number, name: struct.pack("bb", len(name), -number) + name.encode() + struct.pack("<H", 3) + b"\0"
    words = lambda g, name, values, dims=None: record(g, name, 2, dims or [len(values)], struct.pack(f"<{len(values)}H", *values))
    floats = lambda g, name, values, dims=None: record(g, name, 4, dims or [len(values)], struct.pack(f"<{len(values)}f", *values))

    def texts(g, name, values):
        width = max(map(len, values))
        return record(g, name, -1, [width, len(values)], "".join(v.ljust(width) for v in values).encode())

    section = group(1, "POINT") + words(1, "USED", [len(labels)], [1]) + floats(1, "SCALE", [-1.0])
    section += floats(1, "RATE", [rate_hz]) + words(1, "FRAMES", [n]) + texts(1, "UNITS", ["mm"])
    section += texts(1, "LABELS", labels) + texts(1, "X_SCREEN", ["+X"]) + texts(1, "Y_SCREEN", ["+Z"])
    section += group(2, "ANALOG") + words(2, "USED", [n_channels]) + floats(2, "RATE", [rate_hz * RATIO])
    section += texts(2, "LABELS", [f"{name}{number}" for number in PLATES for name in CHANNELS])
    section += texts(2, "UNITS", ["N", "N", "N", "Nmm", "Nmm", "Nmm"] * len(PLATES)) + floats(2, "GEN_SCALE", [1.0])
    section += floats(2, "SCALE", [1.0] * n_channels) + words(2, "OFFSET", [0] * n_channels)
    section += group(3, "FORCE_PLATFORM") + words(3, "USED", [len(PLATES)]) + words(3, "TYPE", [2] * len(PLATES))
    section += words(3, "ZERO", [0, 0])
    a, b = HALF_MM
    quadrants = [(1, -1), (-1, -1), (-1, 1), (1, 1)]
    corners = [v for x, y in PLATES.values() for s, t in quadrants for v in (x + s * a, y + t * b, 0.0)]
    section += floats(3, "CORNERS", corners, [3, 4, len(PLATES)])
    section += floats(3, "ORIGIN", [0.0, 0.0, 0.0] * len(PLATES), [3, len(PLATES)])
    section += words(3, "CHANNEL", list(range(1, n_channels + 1)), [6, len(PLATES)]) + b"\0\0"
    blocks = -(-(len(section) + 4) // 512)
    head = (2, 0x50, len(labels), n_channels * RATIO, 1, n, 0, -1.0, blocks + 2, RATIO, rate_hz)
    with open(output, "xb") as file:
        file.write(struct.pack("<BB5Hf2Hf", *head).ljust(512, b"\0"))
        file.write((struct.pack("BBBB", 1, 0x50, blocks, 84) + section).ljust(512 * blocks, b"\0"))
        for i, row in enumerate(rows):
            file.write(b"".join(struct.pack("<4f", *(row[f"{label}.{axis}"] for axis in "xyz"), 0.0) for label in labels))
            following = min(i + 1, n - 1)
            for k in range(RATIO):
                part = k / RATIO
                loads = [v + part * (w - v) for plate in samples for v, w in zip(plate[i], plate[following])]
                file.write(struct.pack(f"<{n_channels}f", *loads))


if __name__ == "__main__":
    main()
