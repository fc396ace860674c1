"""The chunks of a take, and its header: docs/take-format.md."""

import struct
import zlib
from dataclasses import dataclass, field

from .cursor import Cursor
from .errors import Corrupt

MAGIC = b"\x89TAK\r\n\x1a\n"
HEADER, CHANNELS, STRETCH, FOOTER, SUMMARY = 0x01, 0x02, 0x03, 0x8B, 0x8D
SAMPLED_GROUP, SAMPLES, ORDER = 0x8E, 0x8F, 0x92
VERSIONS = (6, 7)  # 7: key stretches may be further apart


def chunks(data):
    """Types and payloads of chunks. Raises at the first damaged chunk, unlike a reader that recovers what it can."""
    if data[:8] != MAGIC:
        raise Corrupt("not a take")
    at = 8
    while at < len(data):
        cursor = Cursor(data)
        cursor.at = at
        kind = cursor.byte()
        payload = cursor.take(cursor.varint())
        crc = zlib.crc32(data[at : cursor.at])
        if crc != int.from_bytes(cursor.take(4), "little"):
            raise Corrupt(f"the chunk at byte {at} is damaged")
        yield kind, payload
        at = cursor.at


class Record(Cursor):
    """bincode 2 with the standard configuration, after a version byte."""

    def __init__(self, payload, version):
        super().__init__(payload)
        if int.from_bytes(self.take(2), "little") != version:
            raise Corrupt("a record of an unknown version")

    def unsigned(self):
        first = self.byte()
        if first < 251:
            return first
        if first == 255:
            raise Corrupt("an integer too long")
        return int.from_bytes(self.take({251: 2, 252: 4, 253: 8, 254: 16}[first]), "little")

    def signed(self):
        value = self.unsigned()
        return value >> 1 ^ -(value & 1)

    def double(self):
        return struct.unpack("<d", self.take(8))[0]

    def string(self):
        return self.take(self.unsigned()).decode()

    def list(self, item):
        return [item() for _ in range(self.unsigned())]

    def optional(self, item):
        return item() if self.byte() else None

    def channels(self):
        """A table of channels whose labels share prefixes with the preceding label."""
        table = Cursor(self.take(self.unsigned()))
        marker_id, label, labelled, channels = -1, b"", True, []
        while table.left():
            head = table.byte()
            marker_id, shared, n = (marker_id + 1) & 0xFFFF, head >> 4, head & 15
            if n == 15:
                both = table.varint()
                marker_id, labelled = both >> 1, both & 1 == 1
            if n >= 14:
                n = table.varint()
            if shared > len(label):
                raise Corrupt("a label begins like a shorter one")
            label = label[:shared] + table.take(n)
            channels.append({"marker_id": marker_id, "label": label.decode(), "labelled": labelled})
        return channels

    def device(self):
        names = ["driver", "uri", "model", "serial", "firmware"]
        device = {name: self.string() for name in names}
        return device | {"tick_hz": self.unsigned(), "low_latency": self.byte() == 1}

    def source(self):
        source = {name: self.string() for name in ["format", "file", "unit"]}
        source |= {"factor": self.double(), "first_frame": self.unsigned()}
        return source | {"warnings": self.list(self.string)}


@dataclass
class Header:
    software: str
    take_id: bytes
    created_unix_ms: int
    resampler: str
    codec_version: int
    tolerance_mm: float
    rate_hz: float
    up_axis: int
    device: dict | None
    source: dict | None
    channels: list
    stretch_rows: int
    settings: list = field(default_factory=list)

    def tick_hz(self):
        return self.device["tick_hz"] if self.device else 0


def read_header(payload):
    r = Record(payload, 2)
    header = Header(
        r.string(), r.take(16), r.signed(), r.string(), r.unsigned(), r.double(), r.double(),
        r.byte(), r.optional(r.device), r.optional(r.source), r.channels(), r.unsigned(),
        r.list(lambda: (r.string(), r.string())),
    )  # fmt: skip
    r.finish()
    if header.codec_version not in VERSIONS:
        raise Corrupt(f"blocks of version {header.codec_version}, not {' or '.join(map(str, VERSIONS))}")
    return header


GROUP = 64


def read_order(content):
    """By row of the channel table: the column in the source."""
    if content[:2] != b"\x01\x00":
        raise Corrupt("an order of an unknown version")
    cursor = Cursor(content[2:])
    n, columns = cursor.varint(), []
    rest = cursor.rest()
    bits = int.from_bytes(rest, "big")
    n_left = 8 * len(rest)

    def number(width):
        nonlocal n_left
        n_left -= width
        if n_left < 0:
            raise Corrupt("an order that is cut")
        return bits >> n_left & (1 << width) - 1

    for first in range(0, n, GROUP):
        places, following = list(range(first, min(first + GROUP, n))), first
        while places:
            if len(places) > 1 and following in places:
                if number(1):
                    columns.append(following)
                    places.remove(following)
                    following += 1
                    continue
                others = [place for place in places if place != following]
            else:
                others = places
            place = number((len(others) - 1).bit_length())
            if place >= len(others):
                raise Corrupt("an order with a place that there is not")
            columns.append(others[place])
            following = others[place] + 1
            places.remove(columns[-1])
    if n_left > 7 or bits & (1 << n_left) - 1:
        raise Corrupt("an order that is too long")
    return columns


def restored(channels, columns):
    """A channel table in the order of the source; ids stay at their places."""
    labels = {column: channels[row] for row, column in enumerate(columns)}
    pairs = ((labels.get(column, channel), channel) for column, channel in enumerate(channels))
    return [labelled | {"marker_id": channel["marker_id"]} for labelled, channel in pairs]


def read_channels(payload):
    record = Record(payload, 2)
    channels = record.channels()
    record.finish()
    return channels
