"""C3D files as some laboratories write them, byte by byte: what a reader by other hands must find in their export.

Each has a marker that moves, and analog channels whose group is odd in one way, or many frames, or a late first frame.
"""

import struct
from dataclasses import dataclass, field

import numpy as np

INTEL, CHARACTERS, WORDS, FLOATS = 84, -1, 2, 4


@dataclass
class Case:
    """A file, and what of it an export must hold."""

    name: str
    data: bytes
    n_frames: int
    first_frame: int
    analog: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))  # samples by channel, scaled
    rate: float = 100.0
    readers: tuple = ("ezc3d", "py-c3d")


def parameter(group, name, kind, dimensions, data):
    body = struct.pack("bB", kind, len(dimensions)) + bytes(dimensions) + data + b"\0"
    return struct.pack("bb", len(name), group) + name.encode() + struct.pack("<H", len(body) + 2) + body


def group(number, name):
    return struct.pack("bb", len(name), -number) + name.encode() + struct.pack("<H", 3) + b"\0"


def words(number, name, values):
    return parameter(number, name, WORDS, [len(values)], struct.pack(f"<{len(values)}H", *(v & 0xFFFF for v in values)))


def word(number, name, value):
    return parameter(number, name, WORDS, [], struct.pack("<H", value))


def floats(number, name, values):
    dimensions = [len(values)] if len(values) != 1 else []
    return parameter(number, name, FLOATS, dimensions, struct.pack(f"<{len(values)}f", *values))


def texts(number, name, values):
    length = max(map(len, values))
    data = "".join(value.ljust(length) for value in values).encode()
    return parameter(number, name, CHARACTERS, [length, len(values)], data)


def c3d(n_frames, first_frame=1, analog=None, ratio=1, records=b"", rate=100.0):
    """A file of one marker; `analog` has a row a sample, `ratio` rows a frame, stored as they are."""
    n_channels = 0 if analog is None else analog.shape[1]
    last = min(first_frame + n_frames - 1, 65535)
    section = group(1, "POINT") + word(1, "USED", 1) + floats(1, "SCALE", [-1.0]) + floats(1, "RATE", [rate])
    section += texts(1, "UNITS", ["mm"]) + texts(1, "LABELS", ["HEAD"]) + word(1, "FRAMES", min(n_frames, 65535))
    section += group(2, "ANALOG") + word(2, "USED", n_channels)
    section += group(3, "TRIAL")
    end = first_frame + n_frames - 1
    section += words(3, "ACTUAL_START_FIELD", [first_frame, first_frame >> 16])
    section += words(3, "ACTUAL_END_FIELD", [end, end >> 16])
    section += records + b"\0\0"
    n_blocks = -(-(len(section) + 4) // 512)
    header = struct.pack("<BB5Hf2Hf", 2, 0x50, 1, n_channels * ratio, min(first_frame, 65535), last, 0, -1.0, n_blocks + 2, ratio if n_channels else 0, rate)
    data = header.ljust(512, b"\0") + (struct.pack("BBBB", 1, 0x50, n_blocks, INTEL) + section).ljust(512 * n_blocks, b"\0")
    time = np.arange(n_frames) / rate
    points = np.stack([1000 * np.sin(time), 500 + time, 1700 + 0 * time, 0 * time], axis=1)
    rows = points if analog is None else np.concatenate([points, analog.reshape(n_frames, -1)], axis=1)
    data += rows.astype("<f4").tobytes()
    return data.ljust(-(-len(data) // 512) * 512, b"\0")


def cases():
    n_frames, ratio, n_channels = 40, 5, 3
    stored = np.round(1000 * np.sin(np.arange(n_frames * ratio)[:, None] / 9 + np.arange(n_channels)))
    file = lambda records, rate=100.0: c3d(n_frames, 1, stored, ratio, records, rate)
    case = lambda name, records, values: Case(name, file(records), n_frames, 1, values)
    scales = np.array([0.5, 0.25, 2.0])
    scale, rate = floats(2, "SCALE", list(scales)), floats(2, "RATE", [500.0])
    gen = floats(2, "GEN_SCALE", [1.0])
    yield case("bare", b"", stored)
    yield case("no-offset", scale + rate + gen, stored * scales)
    yield case("offsets", words(2, "OFFSETS", [100, 0, 7]) + scale + rate + gen, (stored - [100, 0, 7]) * scales)
    yield case("float-offset", floats(2, "OFFSET", [100.0, 0.0, 7.0]) + scale + rate + gen, (stored - [100, 0, 7]) * scales)
    yield case("odd-offset", floats(2, "OFFSET", [0.5, 0.0, 99999.0]) + scale + rate + gen, (stored - [0.5, 0, 99999.0]) * scales)
    yield case("short-offset", words(2, "OFFSET", [100]) + scale + rate + gen, (stored - [100, 0, 0]) * scales)
    yield case("short-scale", words(2, "OFFSET", [0, 0, 0]) + floats(2, "SCALE", [0.5, 0.25]) + rate + gen, stored * [0.5, 0.25, 1])
    no_rate = words(2, "OFFSET", [0, 0, 0]) + scale + gen
    yield case("no-rate", no_rate, stored * scales)
    # No float32 is five times this rate, and py-c3d wants the quotient of the two to be a whole number.
    yield Case("odd-rate", file(no_rate, 119.88), n_frames, 1, stored * scales, 119.88, ("ezc3d",))
    yield case("few-labels", words(2, "OFFSET", [0, 0, 0]) + scale + rate + texts(2, "LABELS", ["Fz"]), stored * scales)
    yield Case("no-descriptions", c3d(20, records=parameter(1, "DESCRIPTIONS", CHARACTERS, [4, 0], b"")), 20, 1)
    for n_frames, first_frame in [(65534, 1), (65535, 1), (65536, 1), (70001, 1), (65535, 2), (201, 65535), (201, 65536), (201, 70001)]:
        yield Case(f"{n_frames}-frames-from-{first_frame}", c3d(n_frames, first_frame), n_frames, first_frame)
