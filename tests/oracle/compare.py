"""What an export must share with its source. Every function returns a list of complaints."""

import numpy as np

import readers

# What the C3D writer states anew; everything else comes back as it was.
REWRITTEN = {"USED", "SCALE", "DATA_START", "FRAMES", "LONG_FRAMES", "UNITS"}
# Lengths in POINT:UNITS, which becomes mm.
LENGTHS = {("FORCE_PLATFORM", "CORNERS"), ("FORCE_PLATFORM", "ORIGIN")}


def same_bits(a, b):
    """Equal float32 arrays, bit by bit; NaN equals NaN."""
    if a.shape != b.shape:
        return False
    missing = np.isnan(a)
    return bool((missing == np.isnan(b)).all() and (a.view(np.uint32) == b.view(np.uint32))[~missing].all())


def rounding_mm(take):
    """What rounding a reconstruction to float32 may add: half a unit in the last place in each coordinate."""
    largest = np.nanmax(np.abs(take.positions_mm), initial=1.0)
    return float(np.spacing(np.float32(largest))) / 2 * np.sqrt(3)


def compare_csv(take, export, tolerance_mm):
    """`tolerance_mm` None: lossless. Returns the complaints and the largest error."""
    labels, frames, times, positions = export
    complaints = []
    if labels != take.csv_names():
        wrong = [(a, b) for a, b in zip(labels, take.csv_names()) if a != b][:3]
        complaints.append(f"labels differ: {len(labels)} for {len(take.labels)}, {wrong}")
    if positions.shape != take.positions_mm.shape:
        return complaints + [f"shape {positions.shape}, expected {take.positions_mm.shape}"], np.inf
    n_frames = len(positions)
    if not np.array_equal(frames, take.first_frame + np.arange(n_frames)):
        complaints.append(f"frame numbers {frames[:1]}..{frames[-1:]}, expected from {take.first_frame}")
    if n_frames and not np.allclose(times, np.arange(n_frames) / take.rate_hz, rtol=1e-6, atol=1e-9):
        complaints.append("times do not follow the rate")
    n_wrong = int((np.isnan(positions).all(axis=2) != take.gaps).sum())
    n_wrong += int((np.isnan(positions).any(axis=2) != take.gaps).sum())
    if n_wrong:
        complaints.append(f"{n_wrong} gaps differ")
    difference = positions.astype(np.float64) - take.positions_mm.astype(np.float64)
    error = float(np.nanmax(np.sqrt((difference**2).sum(axis=2)), initial=0.0))
    if tolerance_mm is None:
        if not same_bits(positions, take.positions_mm):
            complaints.append(f"not bit-equal, largest error {error} mm")
    elif error > tolerance_mm + rounding_mm(take):
        complaints.append(f"largest error {error} mm")
    return complaints, error


def compare_c3d(take, positions, path):
    """A C3D export beside the CSV export of the same take: points, labels, rate, unit and gaps by both readers."""
    import ezc3d

    complaints = []
    file = ezc3d.c3d(str(path))
    point = file["parameters"]["POINT"]
    labels = c3d_labels(point)
    residuals = file["data"]["meta_points"]["residuals"][0].T
    points = np.moveaxis(file["data"]["points"][:3], 0, 2).transpose(1, 0, 2).astype(np.float32)
    markers = take.marker_points or list(range(len(take.labels)))
    by_ezc3d = points[:, markers] if points.shape[1] > max(markers, default=-1) else points
    py_labels, py_rate, py_points = readers.read_with_py_c3d(path)
    by_py_c3d = py_points[:, markers] if py_points.shape[1] > max(markers, default=-1) else py_points
    for name, found in [("ezc3d", by_ezc3d), ("py-c3d", by_py_c3d)]:
        if not same_bits(found, positions):
            complaints.append(f"c3d: {name} reads other points")
    for name, found in [("ezc3d", labels), ("py-c3d", py_labels)]:
        # py-c3d knows LABELS alone, which holds 255.
        expected = take.names()[:255] if name == "py-c3d" and len(markers) > 255 else take.names()
        if [found[i] for i in markers if i < len(found)] != expected:
            complaints.append(f"c3d: {name} reads other labels")
    for name, found in [("ezc3d", point["RATE"]["value"][0]), ("py-c3d", py_rate)]:
        if np.float32(found) != np.float32(take.rate_hz):
            complaints.append(f"c3d: {name} reads a rate of {found} Hz")
    if readers.strings(point["UNITS"]["value"]) != ["mm"]:
        complaints.append(f"c3d: unit {point['UNITS']['value']}")
    if len(residuals) and not ((residuals[:, markers] == -1) == np.isnan(positions[:, :, 0])).all():
        complaints.append("c3d: residual -1 is not where the gaps are")
    if file["header"]["points"]["first_frame"] + 1 != take.first_frame:
        complaints.append(f"c3d: first frame {file['header']['points']['first_frame'] + 1}")
    return complaints


def c3d_labels(point):
    """All labels: LABELS, LABELS2... hold 255 each."""
    labels, number = readers.strings(point["LABELS"]["value"]), 2
    while f"LABELS{number}" in point:
        labels += readers.strings(point[f"LABELS{number}"]["value"])
        number += 1
    return labels


def compare_given_back(take, source, path):
    """Analog samples, model outputs and all other groups of a C3D source that ezc3d reads."""
    import ezc3d
    import sampled

    complaints = []
    before, after = ezc3d.c3d(str(source)), ezc3d.c3d(str(path))
    if not sampled.same_words(before, after):
        complaints.append("c3d: analog samples differ")
    n_points = before["data"]["points"].shape[1]
    outputs = sorted(set(range(n_points)) - set(take.marker_points))
    for kind in [before["data"]["points"], before["data"]["meta_points"]["residuals"]]:
        again = after["data"]["points"] if kind.shape[0] == 4 else after["data"]["meta_points"]["residuals"]
        if not np.array_equal(kind[:, outputs], again[:, outputs], equal_nan=True):
            complaints.append("c3d: model outputs differ")
    present = ~take.gaps.T

    def residual_bytes(file):
        """As stored: a residual is the byte of the file times the magnitude of POINT:SCALE."""
        scale = abs(file["parameters"]["POINT"]["SCALE"]["value"][0])
        return np.round(file["data"]["meta_points"]["residuals"][0][take.marker_points][present] / scale)

    for what, of in [
        ("residuals", residual_bytes),
        ("camera masks", lambda file: file["data"]["meta_points"]["camera_masks"][:, take.marker_points][:, present]),
    ]:
        if not np.array_equal(of(before), of(after)):
            complaints.append(f"c3d: {what} differ")
    for group, parameters in before["parameters"].items():
        for name, parameter in parameters.items():
            if name == "__METADATA__" or group == "EZC3D" or (group == "POINT" and name in REWRITTEN):
                continue
            found = after["parameters"].get(group, {}).get(name)
            if found is None or not same_values(parameter["value"], found["value"], group, name, take.factor):
                complaints.append(f"c3d: parameter {group}:{name} differs")
    return complaints


def same_values(before, after, group, name, factor):
    if isinstance(before, list):
        return before == after
    before, after = np.asarray(before), np.asarray(after)
    if (group, name) in LENGTHS:
        return before.shape == after.shape and np.allclose(before * factor, after, rtol=1e-6)
    return np.array_equal(before, after, equal_nan=True)
