"""Poses of rigid bodies as each format holds them, read without the project's code."""

import json
from dataclasses import dataclass

import numpy as np

COLUMNS = ["x", "y", "z", "qw", "qx", "qy", "qz", "residual", "state"]
XDF_TYPES = ["PositionX", "PositionY", "PositionZ", "OrientationA", "OrientationB", "OrientationC", "OrientationD", "Residual", "State"]


@dataclass
class Poses:
    """What a reader found, frame by frame; NaN where a body has no pose."""

    names: list
    positions: np.ndarray  # (frames, bodies, 3), mm
    quaternions: np.ndarray  # (frames, bodies, 4): w, x, y, z
    residuals: np.ndarray | None = None  # (frames, bodies), mm
    states: np.ndarray | None = None  # (frames, bodies)
    times_s: np.ndarray | None = None
    is_exact: bool = True  # whether it has the float32 bits of the take


def of_columns(names, values, times_s):
    """Of a table with all columns of each body, one after another."""
    bodies = [name.removesuffix(".x") for name in names[:: len(COLUMNS)]]
    assert names == [f"{body}.{column}" for body in bodies for column in COLUMNS], names[:20]
    values = np.asarray(values, dtype=np.float32).reshape(len(values), len(bodies), len(COLUMNS))
    return Poses(bodies, values[..., :3], values[..., 3:7], values[..., 7], values[..., 8], times_s)


def read_csv(path):
    import pandas

    data = pandas.read_csv(path.with_name(f"{path.stem}.poses.csv"), float_precision="round_trip")
    names = list(data.columns)
    assert names[0] == "time_s"
    lengths = [name for name in names if name.endswith((".x (mm)", ".y (mm)", ".z (mm)", ".residual (mm)"))]
    assert len(lengths) == 4 * (len(names) - 1) // len(COLUMNS)
    return of_columns([name.removesuffix(" (mm)") for name in names[1:]], data.to_numpy()[:, 1:], data["time_s"].to_numpy())


def read_parquet(path):
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(path.with_name(f"{path.stem}.poses.parquet"))
    about = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}
    described = json.loads(about["mocapd.columns"])
    assert about["mocapd.layout"] == "poses" and {column["unit"] for column in described} == {"mm", ""}
    names = [column["name"] for column in described]
    values = np.stack([table[name].to_numpy(zero_copy_only=False).astype(np.float32) for name in names], axis=1)
    return of_columns(names, values, table["time_s"].to_numpy())


def read_npz(path):
    with np.load(path, allow_pickle=False) as found:
        arrays = [found[f"pose_{what}"] for what in ("positions_mm", "quaternions", "residuals_mm", "states")]
        assert [array.dtype for array in arrays] == [np.float32, np.float32, np.float32, np.uint8]
        return Poses(found["body_names"].tolist(), *arrays, found["time_s"])


def read_xdf(path):
    import pyxdf

    (stream,) = [stream for stream in pyxdf.load_xdf(str(path))[0] if stream["info"]["name"] == ["mocapd poses"]]
    channels = stream["info"]["desc"][0]["channels"][0]["channel"]
    assert stream["info"]["type"] == ["MoCap"] and stream["time_series"].dtype == np.float32
    labels, types, units, objects = ([channel[field][0] for channel in channels] for field in ("label", "type", "unit", "object"))
    assert types == XDF_TYPES * (len(types) // len(XDF_TYPES)), types[:20]
    assert units[:9] == ["millimeters"] * 3 + ["quaternion"] * 4 + ["millimeters", "none"], units[:9]
    found = of_columns(labels, stream["time_series"], stream["time_stamps"])
    assert objects[::9] == found.names
    return found


def read_bids(folder):
    import pandas

    (path,) = folder.glob("sub-*/motion/*_motion.tsv")
    about = pandas.read_csv(path.with_name(path.name.replace("_motion.tsv", "_channels.tsv")), sep="\t", keep_default_na=False)
    values = pandas.read_csv(path, sep="\t", header=None, na_values=["n/a"], float_precision="round_trip").to_numpy()
    document = json.loads(path.with_name(path.name.replace(".tsv", ".json")).read_text(encoding="utf-8"))
    kinds = about["type"].tolist()
    for kind in ("POS", "ORNT", "MISC"):
        assert document[f"{kind}ChannelCount"] == kinds.count(kind), kind
    assert document["MotionChannelCount"] == values.shape[1] == len(about)
    first = kinds.index("ORNT") - 3
    own = about.iloc[first:]
    assert own["component"].tolist()[:8] == ["x", "y", "z", "quat_w", "quat_x", "quat_y", "quat_z", "n/a"]
    bodies = own["tracked_point"].tolist()[::8]
    values = values[:, first:].astype(np.float32).reshape(len(values), len(bodies), 8)
    return Poses(bodies, values[..., :3], values[..., 3:7], values[..., 7])


def read_mcap(path):
    """All numbers from /poses; the frames of reference in /bodies must agree with them."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    rows, names, frames = [], [], []
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=["/poses", "/bodies"]):
            if channel.topic == "/bodies":
                frames.append((message.log_time, {found.child_frame_id: found for found in decoded.transforms}))
                continue
            fields = [field.name for field in decoded.DESCRIPTOR.fields if field.name != "timestamp"]
            names = [channel.metadata[field].removesuffix(" (mm)") for field in fields]
            rows.append([message.log_time] + [getattr(decoded, field) for field in fields])
    times_ns = np.array([row[0] for row in rows], dtype=np.int64)
    found = of_columns(names, [row[1:] for row in rows], None)
    assert [time for time, _ in frames] == times_ns.tolist()
    for row, (_, transforms) in enumerate(frames):
        tracked = np.isfinite(found.positions[row, :, 0])
        assert sorted(transforms) == sorted(name for name, there in zip(found.names, tracked) if there)
        for body, name in enumerate(found.names):
            if name in transforms:
                t, q = transforms[name].translation, transforms[name].rotation
                assert transforms[name].parent_frame_id == "mocap"
                assert np.allclose([t.x, t.y, t.z], found.positions[row, body].astype(float) / 1000, atol=1e-9)
                assert np.allclose([q.w, q.x, q.y, q.z], found.quaternions[row, body], atol=1e-6)
    return found


def read_c3d(path):
    """By ezc3d; the quaternions are those of scipy."""
    import ezc3d
    from scipy.spatial.transform import Rotation

    file = ezc3d.c3d(str(path))
    group, matrices = file["parameters"]["ROTATION"], file["data"]["rotations"]
    names = [name.strip() for name in group["LABELS"]["value"]]
    n_frames = file["data"]["points"].shape[2]
    assert group["USED"]["value"][0] == len(names) and group["RATIO"]["value"][0] == 1
    assert group["RATE"]["value"][0] == file["parameters"]["POINT"]["RATE"]["value"][0]
    assert matrices.shape == (4, 4, len(names), n_frames), matrices.shape
    matrices = matrices.transpose(3, 2, 0, 1)
    there = np.isfinite(matrices).all(axis=(2, 3))
    assert np.allclose(matrices[there][:, 3], [0, 0, 0, 1])
    quaternions = np.full((*there.shape, 4), np.nan)
    rotations = matrices[there][:, :3, :3]
    assert np.allclose(rotations @ rotations.transpose(0, 2, 1), np.eye(3), atol=1e-5)
    quaternions[there] = Rotation.from_matrix(rotations).as_quat(scalar_first=True)
    return Poses(names, matrices[..., :3, 3], quaternions, is_exact=False)


READERS = {
    "csv": read_csv,
    "parquet": read_parquet,
    "npz": read_npz,
    "xdf": read_xdf,
    "mcap": read_mcap,
    "bids": read_bids,
    "c3d": read_c3d,
}


def differences(found, wanted):
    """What differs, where the other formats have the float32 bits and C3D has matrices."""
    # In BIDS a body that has the name of a marker has another one.
    names = [name.removesuffix("#2") for name in found.names]
    wrong = [] if names == wanted.names else [f"names {found.names} for {wanted.names}"]
    if found.positions.shape != wanted.positions.shape:
        return [*wrong, f"shape {found.positions.shape} for {wanted.positions.shape}"]
    if found.times_s is not None and not np.allclose(found.times_s, wanted.times_s, atol=1e-9):
        wrong.append("other times")
    for what in ("positions", "quaternions", "residuals", "states"):
        ours, theirs = getattr(found, what), getattr(wanted, what)
        if ours is None:
            continue
        if found.is_exact:
            same = np.array_equal(ours.astype(np.float32), theirs.astype(np.float32), equal_nan=True)
        elif what == "quaternions":
            # Of the same rotation, whatever the sign; angles to a few roundings of float32.
            there = np.isfinite(theirs).all(axis=-1)
            dot = np.abs((ours[there] * theirs[there]).sum(axis=-1)) / np.linalg.norm(theirs[there], axis=-1)
            same = np.array_equal(np.isnan(ours), np.isnan(theirs)) and dot.min(initial=1) > 1 - 1e-6
        else:
            same = np.array_equal(ours.astype(np.float32), theirs, equal_nan=True)
        if not same:
            wrong.append(f"other {what}")
    return wrong
