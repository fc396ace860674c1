"""Writes a motion in other formats with their common libraries.

`killed_at` of each writer is the number of frames after which its process ends as if by SIGKILL; with None it closes
the file. Formats that can grow are written one second at a time.
"""

import os
import struct
import uuid
import xml.sax.saxutils as xml

import numpy as np


def die():
    """Ends the process as SIGKILL does: nothing is closed, flushed or printed."""
    os._exit(9)


def seconds_of(motion):
    step = round(motion.rate_hz)
    for first in range(0, len(motion.frames), step):
        yield first, motion.frames[first : first + step]


def write_c3d(path, motion, killed_at):
    """ezc3d writes the whole file at the end: a recorder that is killed earlier leaves no file."""
    import ezc3d

    c3d = ezc3d.c3d()
    c3d["parameters"]["POINT"]["RATE"]["value"] = [motion.rate_hz]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = tuple(motion.labels)
    c3d["parameters"]["POINT"]["UNITS"]["value"] = ("mm",)
    points = np.ones((4, len(motion.labels), len(motion.frames)))
    points[:3] = motion.frames.transpose(2, 1, 0)
    c3d["data"]["points"] = points
    if killed_at is not None:
        die()
    c3d.write(str(path))


def write_mcap(path, motion, killed_at):
    """The writer of mcap with its default chunks of 1 MiB: one message of float32 positions per frame."""
    from mcap.writer import Writer

    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name="positions", encoding="", data=b"")
        channel = writer.register_channel(schema_id=schema, topic="/markers", message_encoding="float32")
        for i, frame in enumerate(motion.frames):
            if i == killed_at:
                die()
            time_ns = round(i * 1e9 / motion.rate_hz)
            writer.add_message(channel, log_time=time_ns, publish_time=time_ns, data=frame.astype("<f4").tobytes())
        writer.finish()


def write_hdf5(path, motion, killed_at, flush=False):
    """h5py: one dataset that grows with each frame, optionally flushed after each second."""
    import h5py

    file = h5py.File(path, "w")
    shape = (0, len(motion.labels), 3)
    data = file.create_dataset("positions", shape, "<f4", maxshape=(None, *shape[1:]), chunks=(120, *shape[1:]))
    data.attrs["labels"] = motion.labels
    for first, part in seconds_of(motion):
        for row in part:
            if data.shape[0] == killed_at:
                die()
            data.resize(data.shape[0] + 1, axis=0)
            data[-1] = row
        if flush:
            file.flush()
    file.close()


def write_hdf5_flushed(path, motion, killed_at):
    write_hdf5(path, motion, killed_at, flush=True)


def write_xdf(path, motion, killed_at):
    """XDF 1.0 as written by LabRecorder: a samples chunk each second, a boundary chunk every ten, a footer at the
    end."""
    boundary = uuid.UUID("43a546dc-cbf5-410f-b30e-d5467383cbe4").bytes
    n = 3 * len(motion.labels)

    def chunk(tag, content):
        length = len(content) + 2
        return b"\x04" + struct.pack("<I", length) + struct.pack("<H", tag) + content

    info = (
        f"<?xml version='1.0'?><info><name>markers</name><type>Mocap</type><channel_count>{n}</channel_count>"
        f"<nominal_srate>{motion.rate_hz}</nominal_srate><channel_format>float32</channel_format>"
        f"<created_at>0</created_at><desc><labels>{xml.escape(' '.join(motion.labels))}</labels></desc></info>"
    )
    with open(path, "wb", buffering=0) as file:
        file.write(b"XDF:" + chunk(1, b"<?xml version='1.0'?><info><version>1.0</version></info>"))
        stream = struct.pack("<I", 1)
        file.write(chunk(2, stream + info.encode()))
        written = 0
        for first, part in seconds_of(motion):
            if killed_at is not None and first + len(part) > killed_at:
                die()
            samples = b"".join(
                b"\x08" + struct.pack("<d", (first + i) / motion.rate_hz) + row.astype("<f4").tobytes()
                for i, row in enumerate(part)
            )
            file.write(chunk(3, stream + b"\x04" + struct.pack("<I", len(part)) + samples))
            written += len(part)
            if (first // round(motion.rate_hz)) % 10 == 9:
                file.write(chunk(5, boundary))
        footer = f"<?xml version='1.0'?><info><first_timestamp>0</first_timestamp><sample_count>{written}</sample_count></info>"
        file.write(chunk(6, stream + footer.encode()))


WRITERS = {
    "c3d": write_c3d,
    "mcap": write_mcap,
    "h5": write_hdf5,
    "flushed.h5": write_hdf5_flushed,
    "xdf": write_xdf,
}
