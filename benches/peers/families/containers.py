"""Common file formats with lossless float32, gaps included: one size for all tolerances.

C3D stores four float32 for each sample, also for missing ones. Parquet has one column per channel, MCAP one message
per frame. All are read back and compared, gaps included.
"""

import io
import tempfile
from pathlib import Path

import ezc3d
import mcap
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from families.base import Codec, Way


def rows(take):
    return take.positions_mm.reshape(len(take.positions_mm), -1)


def channels(array, take):
    return np.ascontiguousarray(np.asarray(array, np.float32).reshape(len(take.positions_mm), -1).T)


def c3d_encode(take, _):
    frames, markers, _ = take.shape
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [take.rate_hz]
    file["parameters"]["POINT"]["LABELS"]["value"] = [f"m{i}" for i in range(markers)]
    points = np.ones((4, markers, frames))
    points[:3] = take.positions_mm.transpose(2, 1, 0)
    file["data"]["points"] = points
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "take.c3d"
        file.write(str(path))
        return path.read_bytes()


def c3d_decode(take, data):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "take.c3d"
        path.write_bytes(data)
        return channels(ezc3d.c3d(str(path))["data"]["points"][:3].transpose(2, 1, 0), take)


def parquet_encode(take, _):
    columns = {f"c{i}": column for i, column in enumerate(rows(take).T)}
    file = io.BytesIO()
    options = {"compression": "zstd", "use_dictionary": False, "column_encoding": "BYTE_STREAM_SPLIT"}
    pq.write_table(pa.table({n: np.ascontiguousarray(c) for n, c in columns.items()}), file, **options)
    return file.getvalue()


def parquet_decode(take, data):
    table = pq.read_table(io.BytesIO(data), use_threads=False)
    return np.stack([column.to_numpy() for column in table.columns])


def mcap_encode(take, _):
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.ZSTD)
    writer.start()
    schema = writer.register_schema("positions", "", b"")
    channel = writer.register_channel("markers", "float32", schema)
    for frame, row in enumerate(rows(take)):
        t_ns = round(frame * 1e9 / take.rate_hz)
        writer.add_message(channel, t_ns, np.ascontiguousarray(row).tobytes(), t_ns)
    writer.finish()
    return file.getvalue()


def mcap_decode(take, data):
    messages = [message.data for _, _, message in make_reader(io.BytesIO(data)).iter_messages()]
    return channels(np.frombuffer(b"".join(messages), np.float32), take)


def codecs():
    return [
        lossless("C3D float", f"ezc3d {ezc3d.__version__}", c3d_encode, c3d_decode),
        lossless("Parquet zstd", f"pyarrow {pa.__version__}", parquet_encode, parquet_decode),
        lossless("MCAP zstd", f"mcap {mcap.__version__}", mcap_encode, mcap_decode),
    ]


def lossless(name, versions, encode, decode):
    def checked(take, data):
        decoded = decode(take, data)
        if not np.array_equal(decoded, rows(take).T, equal_nan=True):
            raise AssertionError(f"{name} changed {take.name}")
        return decoded

    return Codec(name, versions, lambda take: [Way("float32", encode, checked)], lossless=True)
