"""Reads what `mocapd export` writes, each format with a program that is not ours."""

import io
import json
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas

import opensim_trc
import readers


@dataclass
class Export:
    """What a reader found."""

    labels: list
    positions_mm: np.ndarray  # float32 (frames, markers, 3); NaN where missing
    rate_hz: float | None = None
    times_s: np.ndarray | None = None
    first_frame: int | None = None
    events: list | None = field(default=None)  # (seconds from the first frame, label); None: the format has none


def float32(values):
    """Numbers as printed, once rounded; a sample with a coordinate missing is missing."""
    positions = np.asarray(values, dtype=np.float64).astype(np.float32)
    positions = positions.reshape(len(positions), -1, 3)
    positions[np.isnan(positions).any(axis=2)] = np.nan
    return positions


def table(text, **options):
    return pandas.read_csv(text, float_precision="round_trip", keep_default_na=False, na_values={"": ""}, **options)


def numbers(text, names=None, **options):
    """A table of numbers alone; empty cells and `n/a` are NaN."""
    return pandas.read_csv(text, float_precision="round_trip", dtype=np.float64, names=names, **options)


def triplets(names, separator):
    labels = []
    for x, y, z in zip(names[::3], names[1::3], names[2::3], strict=True):
        label = x.rsplit(separator, 1)[0]
        ends = [name[len(label) :].lower() for name in (x, y, z)]
        assert ends == [separator + axis for axis in "xyz"], (x, y, z)
        labels.append(label)
    return labels


def read_csv(path):
    import csv

    with open(path, newline="", encoding="utf-8") as file:
        names = next(csv.reader(file))
    assert names[:2] == ["frame", "time_s"], names[:2]
    data = numbers(path, names=range(len(names)), skiprows=1).to_numpy()
    return Export(
        triplets(names[2:], "."), float32(data[:, 2:]), times_s=data[:, 1], first_frame=int(data[0, 0])
    )


def read_long(path, shape):
    """`shape`: how many frames and labels there are, which the rows need not tell."""
    first_frame, n_frames, labels = shape
    data = table(path, dtype={"label": str})
    assert list(data.columns) == ["frame", "time_s", "label", "x_mm", "y_mm", "z_mm"], list(data.columns)
    columns = {label: column for column, label in enumerate(labels)}
    positions = np.full((n_frames, len(labels), 3), np.nan, dtype=np.float32)
    rows = data["frame"].to_numpy() - first_frame
    places = data["label"].map(columns).to_numpy()
    assert len(set(zip(rows, places))) == len(data), "a sample comes twice"
    positions[rows, places] = data[["x_mm", "y_mm", "z_mm"]].to_numpy().astype(np.float32)
    return Export(labels, positions)


def read_trc(path):
    metadata, labels, frames, times, positions = opensim_trc.read(path)
    assert metadata["Units"] == "mm", metadata["Units"]
    assert (np.diff(frames) == 1).all()
    return Export(labels, float32(positions), float(metadata["DataRate"]), times, int(frames[0]))


def read_tsv(path):
    """QTM's names and values, then rows; three zeros are a missing sample."""
    with open(path, encoding="utf-8", newline="") as file:
        header, events = {}, []
        for line in file:
            name, *values = line.rstrip("\n").split("\t")
            if name == "EVENT":
                events.append((float(values[2]), values[0], int(values[1])))
                continue
            header[name] = values
            if name == "MARKER_NAMES":
                break
        labels = header["MARKER_NAMES"]
        rest = file.read()
    assert header["DATA_INCLUDED"] == ["3D"]
    names, first_frame = None, 1
    if rest.startswith("Frame\tTime"):
        names, rest = rest.split("\n", 1)
        assert triplets(names.split("\t")[2:], " ") == labels
    data = numbers(io.StringIO(rest), header=None, sep="\t").to_numpy()
    times = None
    if names:
        first_frame, times, data = int(data[0, 0]), data[:, 1], data[:, 2:]
    assert int(header["NO_OF_FRAMES"][0]) == len(data)
    assert int(header["NO_OF_MARKERS"][0]) == len(labels)
    positions = float32(data)
    positions[(positions == 0).all(axis=2)] = np.nan
    rate = float(header["FREQUENCY"][0])
    assert all(abs((frame - first_frame) / rate - time) < 1e-9 for time, _, frame in events), events
    return Export(labels, positions, rate, times, first_frame, [(time, label) for time, label, _ in events])


def read_npz(path):
    with np.load(path, allow_pickle=False) as found:
        positions, labels = found["positions_mm"], found["labels"]
        assert positions.dtype == np.float32 and str(found["unit"]) == "mm"
        assert found["labelled"].shape == labels.shape
        assert np.array_equal(found["event_frame"], np.round(found["event_time_s"] * found["rate_hz"]))
        events = list(zip(found["event_time_s"].tolist(), found["event_label"].tolist()))
        return Export(
            labels.tolist(), positions, float(found["rate_hz"]), found["time_s"], int(found["first_frame"]), events
        )


def read_xdf(path):
    import pyxdf

    streams, _ = pyxdf.load_xdf(str(path))
    by_type = {stream["info"]["type"][0]: stream for stream in streams}
    motion = by_type["MoCap"]
    channels = motion["info"]["desc"][0]["channels"][0]["channel"]
    assert {channel["unit"][0] for channel in channels} == {"millimeters"}
    kinds = [channel["type"][0] for channel in channels]
    assert kinds == ["PositionX", "PositionY", "PositionZ"] * (len(channels) // 3)
    labels = triplets([channel["label"][0] for channel in channels], ".")
    assert labels == [channel["marker"][0] for channel in channels[::3]]
    events = []
    if "Markers" in by_type:
        stream = by_type["Markers"]
        events = [(time, values[0]) for time, values in zip(stream["time_stamps"], stream["time_series"])]
    series = motion["time_series"]
    assert series.dtype == np.float32
    positions = series.reshape(len(series), -1, 3)
    return Export(labels, positions, float(motion["info"]["nominal_srate"][0]), motion["time_stamps"], None, events)


def validate_bids(folder):
    """What the official validator finds wrong; warnings are advice to the dataset's authors."""
    validator = Path(sys.executable).with_name("bids-validator-deno")
    command = [str(validator), str(folder), "--format", "json"]
    result = subprocess.run(command, capture_output=True, text=True)
    issues = json.loads(result.stdout)["issues"]["issues"]
    return [
        f"{issue['code']} {issue.get('subCode', '')} at {issue.get('location', '')}"
        for issue in issues
        if issue["severity"] == "error"
    ]


def read_bids(folder):
    (motion,) = folder.glob("sub-*/motion/*_motion.tsv")
    beside = lambda suffix: motion.with_name(motion.name.replace("motion.tsv", suffix))
    about = json.loads(beside("motion.json").read_text(encoding="utf-8"))
    channels = table(beside("channels.tsv"), sep="\t", dtype=str)
    assert (channels["type"] == "POS").all() and (channels["units"] == "mm").all()
    labels = triplets(list(channels["name"]), "_")
    assert labels == list(channels["tracked_point"][::3])
    data = numbers(motion, header=None, sep="\t", na_values=["n/a"]).to_numpy()
    assert about["MotionChannelCount"] == data.shape[1] and about["TrackedPointsCount"] == len(labels)
    rate = about["SamplingFrequency"]
    assert abs(about["RecordingDuration"] * rate - len(data)) < 1e-6
    events = []
    if beside("events.tsv").exists():
        rows = table(beside("events.tsv"), sep="\t", dtype={"trial_type": str})
        events = list(zip(rows["onset"], rows["trial_type"]))
    return Export(labels, float32(data), rate, None, None, events)


def c3d_events(path):
    """By ezc3d: seconds from the first frame, label."""
    import ezc3d

    file = ezc3d.c3d(str(path))
    group = file["parameters"].get("EVENT", {})
    if "USED" not in group or not group["USED"]["value"][0]:
        return []
    n = int(group["USED"]["value"][0])
    minutes, seconds = group["TIMES"]["value"].reshape(2, -1)
    rate = file["parameters"]["POINT"]["RATE"]["value"][0]
    start = file["header"]["points"]["first_frame"] / rate
    labels = readers.strings(group["LABELS"]["value"])
    contexts = readers.strings(group["CONTEXTS"]["value"])
    texts = [label if context in ("", "General") else f"{context} {label}".strip() for context, label in zip(contexts, labels)]
    assert len(texts) == n == len(seconds)
    return [(60 * m + s - start, text) for m, s, text in zip(minutes, seconds, texts)]
