"""Motion of odd sizes, as CSV to import, and C3D files with analog channels: what no recorded take has, or what is to be
compared where there are none."""

import sys
from pathlib import Path

import numpy as np

import readers

sys.path.append(str(Path(__file__).resolve().parents[2] / "python" / "tests"))

import c3d_files  # noqa: E402


def takes(folder):
    """Names, paths and what is in them."""
    yield from (
        write(folder, "many", 300, 40, [f"marker {i}" if i % 50 else f"{i}: <ä>, \"b\" & c" for i in range(300)]),
        write(folder, "long", 2, 70_000, ["a", "b"]),
        write(folder, "repeated", 6, 50, ["A", "A", "A#2", "B", "u005", "A"]),
        write(folder, "single", 1, 2, ["only"]),
    )


def write(folder, name, n_markers, n_frames, labels):
    """A smooth motion in millimetres with a fifth of the samples missing, first and last marker among them."""
    time = np.arange(n_frames)[:, None, None] / 100
    phase = np.arange(3 * n_markers).reshape(n_markers, 3)
    positions = (1000 * np.sin(0.7 * time + phase) + 10 * phase).astype(np.float32)
    gaps = (np.arange(n_frames)[:, None] // 3 + np.arange(n_markers)) % 5 == 4
    positions[gaps] = np.nan
    quoted = ['"%s.%s"' % (label.replace('"', '""'), axis) for label in labels for axis in "xyz"]
    path = folder / f"{name}.csv"
    with open(path, "w", encoding="utf-8") as file:
        print("# rate=100 units=mm", file=file)
        print("frame,time_s," + ",".join(quoted), file=file)
        for index, row in enumerate(positions.reshape(n_frames, -1)):
            cells = ",".join("" if np.isnan(v) else repr(float(v)) for v in row)
            print(f"{index + 12},{index / 100},{cells}", file=file)
    unlabelled = lambda column, label: "" if label == f"u{column:03d}" else label
    labels = [unlabelled(column, label) for column, label in enumerate(labels, 1)]
    return path, readers.Take(labels, 100.0, 12, positions, 1.0, [], "generated")


def sampled(folder):
    """Paths of C3D files with EMG, force plates, residuals and camera masks: signed, unsigned and float samples."""
    n_frames, ratio = 60, 10
    time = np.arange(n_frames * ratio) / (100 * ratio)
    emg = np.stack([900 * np.sin(260 * time) * np.sin(5 * time), 300 * np.cos(410 * time)], axis=1)
    rise = np.clip(np.sin(6 * time), 0, None)
    load = np.stack([40 * rise, -60 * rise * np.cos(9 * time), 800 * rise], axis=1)
    at = np.stack([300 + 200 * time, 220 - 90 * time, 0 * time], axis=1)
    plate = lambda kind, turn_deg: c3d_files.Plate(kind, (300.0, 200.0, 0.0), turn_deg, load, at, 8 * rise)
    points = c3d_files.walk(n_frames)
    # Residuals of 0 to 9 and cameras 1 to 7 in every combination.
    number = np.arange(points.shape[0] * points.shape[1]).reshape(*points.shape[:2], 1)
    common = {"fourth_words": number % 10 + 256 * (number % 128), "first_frame": 12}
    def file(name, plates, scales, offsets, more=b"", **options):
        """The channels of the plates, then two of EMG with the same label."""
        stored = np.concatenate([*(plate.channels() for plate in plates), emg], axis=1) / scales + offsets
        labels, units = [], []
        for plate in plates:
            labels += ["Fx1", "Fy1", "Fz1", "Mx1", "My1", "Mz1"]
            units += ["V"] * 6 if plate.kind == 4 else ["N"] * 3 + ["Nmm"] * 3
        labels, units = [*labels, "EMG", "EMG"], [*units, "mV", "mV"]
        wrapped = np.array(offsets) & 0xFFFF
        records = c3d_files.channel_records(len(labels), labels=labels, units=units, scales=scales, offsets=wrapped, more=more)
        records += c3d_files.plate_records(plates) if plates else b""
        records += c3d_files.texts(c3d_files.POINT, "DESCRIPTIONS", [f"marker {n}" for n in range(points.shape[1])])
        path = folder / f"{name}.c3d"
        path.write_bytes(c3d_files.c3d_file(points, stored, ratio, records, **options, **common))
        return path

    unsigned = c3d_files.texts(c3d_files.ANALOG, "FORMAT", ["UNSIGNED"])
    scales = [0.01, 0.01, 0.05, 8.0, 8.0, 1.0, 0.05, 0.025]
    yield file("signed", [plate(2, 0)], scales, [0, 0, 11, 0, 0, 3, -100, 7], scale=0.1)
    yield file("unsigned", [], scales[-2:], [32768, 40000], unsigned, scale=0.1)
    yield file("float", [plate(4, 37)], [1.0] * 6 + [0.5, 0.1], [0] * 8)


def plates_with_matrices(folder):
    """Paths of C3D files with force plates of type 4, each with a matrix of its own in which every cell counts: two of
    them, in millimetres and in metres, and one behind a plate of type 2, whose matrix does not count."""
    n_frames, ratio = 40, 5
    time = np.arange(n_frames * ratio) / (100 * ratio)
    rise = np.clip(np.sin(9 * time), 0, None)
    points = c3d_files.walk(n_frames)
    plates = []
    for number, (kind, turn_deg) in enumerate([(2, 90), (4, 37), (4, -110)]):
        load = np.stack([30 * rise * (number - 1), -70 * rise * np.cos(9 * time), (700 + 90 * number) * rise], axis=1)
        at = np.stack([300 + 700 * number + 90 * time, 220 - 80 * time, 0 * time], axis=1)
        plate = c3d_files.Plate(kind, (300.0 + 700 * number, 200.0, 0.0), turn_deg, load, at, (6 - 5 * number) * rise)
        cells = np.arange(36).reshape(6, 6) + 10 * number
        plate.calibration = np.diag([50.0 + number, 52, 190, 9000, 9300, 4100]) + 4 * np.sin(cells)
        plates.append(plate)
    def file(name, plates, unit="mm"):
        per_mm = {"mm": 1.0, "m": 1e-3}[unit]
        stored = np.concatenate([plate.channels() for plate in plates], axis=1)
        units = [u for plate in plates for u in (["V"] * 6 if plate.kind == 4 else ["N"] * 3 + ["Nmm"] * 3)]
        labels = [f"{name}{number}" for plate in range(len(plates)) for name, number in zip("abcdef", [plate + 1] * 6)]
        records = c3d_files.channel_records(len(labels), labels=labels, units=units)
        records += c3d_files.plate_records(plates, per_mm=per_mm)
        path = folder / f"{name}.c3d"
        path.write_bytes(c3d_files.c3d_file(points * per_mm, stored, ratio, records, unit=unit))
        return path

    yield file("matrices", plates[1:])
    yield file("matrices-in-metres", plates[1:], unit="m")
    yield file("matrix-behind-another", plates[:2])
