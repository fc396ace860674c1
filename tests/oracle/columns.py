"""Reads Parquet and MCAP without the project's code: pyarrow, pandas, polars, DuckDB, and the mcap package.

Every reader gives what compare.compare_csv takes: labels, frame numbers, times in seconds, positions in millimetres.
"""

import json

import numpy as np


def metadata(path):
    import pyarrow.parquet

    file = pyarrow.parquet.ParquetFile(path)
    return {key.decode(): value.decode() for key, value in file.metadata.metadata.items()}


def pyarrow_columns(path):
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(path)
    return {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}


def pandas_columns(path):
    import pandas

    table = pandas.read_parquet(path)
    return {name: table[name].to_numpy() for name in table.columns}


def polars_columns(path):
    import polars

    table = polars.read_parquet(path)
    return {name: table[name].to_numpy() for name in table.columns}


def duckdb_columns(path):
    import duckdb

    with duckdb.connect() as connection:
        columns = connection.execute("SELECT * FROM read_parquet(?)", [str(path)]).fetchnumpy()
    return {name: np.ma.filled(values, np.nan) if np.ma.isMaskedArray(values) else values
            for name, values in columns.items()}


READERS = [pyarrow_columns, pandas_columns, polars_columns, duckdb_columns]


def read_long(path, columns):
    """A row a sample; frames and markers without one are known by the metadata alone."""
    about = metadata(path)
    labels, first = unique(json.loads(about["mocapd.labels"])), int(about["mocapd.first_frame"])
    n_frames, rate_hz = int(about["mocapd.frames"]), float(about["mocapd.rate_hz"])
    table = columns(path)
    positions = np.full((n_frames, len(labels), 3), np.nan, np.float32)
    place = {label: column for column, label in enumerate(labels)}
    rows = np.asarray(table["frame"], dtype=np.int64) - first
    markers = np.array([place[str(marker)] for marker in table["marker"]], dtype=np.int64)
    if len(set(zip(rows.tolist(), markers.tolist()))) != len(rows):
        raise ValueError("a sample comes twice")
    positions[rows, markers] = np.stack([table[axis] for axis in "xyz"], axis=1).reshape(-1, 3)
    if not np.allclose(np.asarray(table["time_s"], dtype=float), rows / rate_hz, rtol=1e-9, atol=1e-12):
        raise ValueError("times are not those of the frames")
    return labels, first + np.arange(n_frames), np.arange(n_frames) / rate_hz, positions


def read_wide(path, columns):
    """A row a frame, three columns a marker."""
    table = columns(path)
    names = list(table)
    if names[:2] != ["frame", "time_s"] or len(names) % 3 != 2:
        raise ValueError(f"columns {names[:5]}...")
    labels = [name[:-2] for name in names[2::3]]
    if names[2:] != [f"{label}.{axis}" for label in labels for axis in "xyz"]:
        raise ValueError("columns are not x, y and z of markers")
    values = [np.asarray(table[name], dtype=np.float32) for name in names[2:]]
    positions = np.stack(values, axis=1).reshape(-1, len(labels), 3) if values else None
    return labels, table["frame"], table["time_s"], positions


def unique(labels):
    used, names = set(), []
    for label in labels:
        name, number = label, 2
        while name in used:
            name, number = f"{label}#{number}", number + 1
        used.add(name)
        names.append(name)
    return names


def read_mcap(path):
    """Decoded by the schemas that are in the file, and again by Foxglove's own package: both must agree."""
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    own = {"foxglove.PointCloud": PointCloud, "foxglove.SceneUpdate": SceneUpdate,
           "foxglove.FrameTransform": FrameTransform}
    clouds, scenes, transforms, n_sampled = [], [], [], 0
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        about = {key: value for record in reader.iter_metadata() for key, value in record.metadata.items()}
        summary = reader.get_summary()
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            if schema.name in ("mocapd.Analog", "mocapd.ForcePlates"):
                if set(channel.metadata) != {field.name for field in decoded.DESCRIPTOR.fields} - {"timestamp"}:
                    raise ValueError(f"{schema.name} has fields that are not described")
                n_sampled += 1
                continue
            theirs = own[schema.name]()
            theirs.ParseFromString(message.data)
            if list(theirs.ListFields()) and str(theirs) != str(decoded):
                raise ValueError(f"{schema.name} says something else by its published schema")
            if theirs.SerializeToString(deterministic=True) != decoded.SerializeToString(deterministic=True):
                raise ValueError(f"{schema.name} has other fields by its published schema")
            if len(unknown_fields(theirs)):
                raise ValueError(f"{schema.name} has fields that its published schema has not")
            {"/markers": clouds, "/names": scenes, "/tf": transforms}[channel.topic].append((message, theirs))
    if summary.statistics.message_count != len(clouds) + len(scenes) + len(transforms) + n_sampled:
        raise ValueError("its summary counts other messages")
    if len(transforms) != 1 or not scenes and clouds:
        raise ValueError(f"{len(transforms)} transforms, {len(scenes)} scenes")
    labels = json.loads(about["mocapd.labels"])
    rate_hz, first = float(about["mocapd.rate_hz"]), int(about["mocapd.first_frame"])
    start_ns = int(about["mocapd.created_unix_ms"]) * 1_000_000
    positions = np.full((len(clouds), len(labels), 3), np.nan)
    point = np.dtype([("at", "<f4", 3), ("marker", "<u2"), ("nothing", "<u2")])
    times_s = np.zeros(len(clouds))
    for row, (message, cloud) in enumerate(clouds):
        if [(field.name, field.offset, field.type) for field in cloud.fields] != [
            ("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("marker", 12, 3)
        ] or cloud.point_stride != point.itemsize:
            raise ValueError("points are not x, y, z and marker")
        stamp_ns = cloud.timestamp.seconds * 10**9 + cloud.timestamp.nanos
        if not message.log_time == message.publish_time == stamp_ns:
            raise ValueError("a message has another time than its content")
        times_s[row] = (stamp_ns - start_ns) / 1e9
        points = np.frombuffer(cloud.data, point)
        positions[row, points["marker"]] = points["at"].astype(np.float64) * 1000
    for message, scene in scenes:
        row = round((message.log_time - start_ns) / 1e9 * rate_hz)
        seen = np.flatnonzero(np.isfinite(positions[row, :, 0]))
        texts = scene.entities[0].texts
        if [text.text for text in texts] != [unique(labels)[column] for column in seen]:
            raise ValueError(f"names at frame {row} are not those of the points")
        at = np.array([[text.pose.position.x, text.pose.position.y, text.pose.position.z] for text in texts])
        if len(texts) and not np.allclose(at * 1000, positions[row, seen], atol=1e-2, rtol=1e-6):
            raise ValueError(f"names at frame {row} are not where the points are")
    return unique(labels), first + np.arange(len(clouds)), times_s, positions.astype(np.float32)


def unknown_fields(message):
    from google.protobuf.unknown_fields import UnknownFieldSet

    return UnknownFieldSet(message)
