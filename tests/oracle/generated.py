"""Motion of odd sizes, as CSV to import: what no recorded take has."""

import numpy as np

import readers


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
