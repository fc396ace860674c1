"""Groups of sampled channels in a take, and the foreign parts that they stand for: docs/take-format.md, "Sampled
channels", and docs/foreign.md."""

import math
import struct
import zlib
from dataclasses import dataclass

from .container import Record
from .cursor import Cursor
from .errors import Corrupt
from .sampled import SampledDecoder, is_finite

KEY, LOST = 1, 2
FLOAT32, INT16, UINT16 = range(3)
NAN = 0x7FC00000
POSES = "poses"
# States of poses in outputs.
OTHER, MISSING = 3, 253
ROWS_MAX, SAMPLES_MAX = 1 << 17, 1 << 20


@dataclass
class Group:
    source: int
    number: int
    kind: str
    form: int
    first_channel: int
    part_channels: int
    samples_per_frame: int
    rate_hz: float
    first_frame: int
    n_samples: int | None
    channels: list  # (name, unit, index, scale, offset)

    def __post_init__(self):
        self.bounds = []  # of each channel, in stored samples; none for exact ones
        self.decoder = SampledDecoder()
        self.samples = [[] for _ in self.channels]  # by channel: the bits of each sample, None for a lost one

    def read(self, key, first, n, block):
        if first != len(self.samples[0]):
            raise Corrupt(f"samples of group {self.number} are missing")
        if n > ROWS_MAX or n * len(self.channels) > SAMPLES_MAX:
            raise Corrupt(f"a block of {n} samples")
        for samples, decoded in zip(self.samples, self.decoder.decode(block, n, key), strict=True):
            samples += decoded


def read_group(payload):
    inflated = zlib.decompressobj(-15)
    body = inflated.decompress(payload[2:])
    if not inflated.eof or inflated.unused_data:
        raise Corrupt("a description that does not inflate")
    version = int.from_bytes(payload[:2], "little")
    r = Record(payload[:2] + body, version if version in (2, 3) else 1)
    group = Group(
        r.unsigned(), r.unsigned(), r.string(), r.unsigned(), r.unsigned(), r.unsigned(), r.unsigned(),
        r.double(), r.unsigned(), r.optional(r.unsigned),
        r.list(lambda: (r.string(), r.string(), r.unsigned(), r.double(), r.double())),
    )  # fmt: skip
    if version == 2:
        group.bounds = [r.double() for _ in group.channels]
        check_bounds(group)
    elif version == 3:
        # Poses: those of rigid bodies; without bounds they are exact.
        group.bounds = [r.double() for _ in group.channels] if r.left() else []
        check_bounds(group)
    r.finish()
    return group


def check_bounds(group):
    """A bound of an error is a size, and of integers an integer."""
    for bound in group.bounds:
        if not (math.isfinite(bound) and bound >= 0) or group.form != 0 and bound != int(bound):
            raise Corrupt("a bound that is none")


def read_samples(payload, groups):
    """Adds the samples of a chunk to those of their group."""
    cursor = Cursor(payload)
    head, number, first, n = cursor.byte(), cursor.varint(), cursor.varint(), cursor.varint()
    group = next((group for group in groups if group.number == number), None)
    if group is None or n == 0:
        raise Corrupt("samples of no group, or none")
    if head == LOST:
        cursor.byte()
        cursor.finish()
        for samples in group.samples:
            samples += [None] * n
    elif head in (0, KEY):
        group.read(head == KEY, first, n, cursor.rest())
    else:
        raise Corrupt("samples of an unknown form")


def poses(group):
    """The poses of a group, docs/poses.md: for each sample and body the number of its state in outputs, and eight float32."""
    number = struct.Struct("<f")
    value = lambda bits: number.unpack(bits.to_bytes(4, "little"))[0]
    is_nan = lambda bits: bits & 0x7FFFFFFF > 0x7F800000
    for numbers in zip(*group.samples):
        for first in range(0, len(numbers), 8):
            body = numbers[first : first + 8]
            if body[0] is None:
                yield bytes([MISSING]) + NAN.to_bytes(4, "little") * 8
                continue
            code = body[7] - NAN if NAN < body[7] < NAN + 256 else 0
            turn = [value(bits) for bits in body[3:7]]
            if not code and group.bounds:
                w, x, y, z = turn
                length = math.sqrt((w * w + x * x) + (y * y + z * z))
                turn = [value(int.from_bytes(number.pack(q / length), "little")) for q in turn] if length else [math.nan] * 4
            finite = all(map(math.isfinite, turn)) and all(is_finite(bits) for bits in body[:3])
            if code or not finite:
                state = code if code in (1, 2, 254, 255) else OTHER
                yield bytes([state]) + NAN.to_bytes(4, "little") * 8
                continue
            residual = NAN if is_nan(body[7]) else body[7]
            words = [*body[:3], *(int.from_bytes(number.pack(q), "little") for q in turn), residual]
            yield b"\0" + b"".join(word.to_bytes(4, "little") for word in words)


def integer(bits, form):
    """The integer of 16 bits that was stored as a float."""
    sign, exponent, mantissa = bits >> 31, bits >> 23 & 0xFF, bits & 0x7FFFFF | 1 << 23
    value = 0 if exponent == 0 else mantissa >> 150 - exponent if exponent < 150 else mantissa
    value = -value if sign else value
    if not is_finite(bits) or not (-32768 <= value < 32768 if form == INT16 else 0 <= value < 65536):
        raise Corrupt("no integer of 16 bits")
    return value & 0xFFFF


def column(samples, form):
    """A column of a block: planes of zigzag-encoded differences."""
    width, words = 4, []
    if form != FLOAT32 and None not in samples:
        width, words = 2, [integer(bits, form) for bits in samples]
    else:
        bits = (NAN if bits is None else bits for bits in samples)
        words = [~bits & 0xFFFFFFFF if bits >> 31 else bits | 1 << 31 for bits in bits]
    top, before, differences = 1 << 8 * width, 0, []
    for word in words:
        difference = (word - before) % top
        difference -= top if difference >= top >> 1 else 0
        differences.append((difference << 1 ^ difference >> 31) % top)
        before = word
    return b"".join(bytes(d >> 8 * plane & 0xFF for d in differences) for plane in reversed(range(width)))


def parts(groups, order=None):
    """The foreign parts that consecutive groups stand for: kinds and blocks of columns, with `order` in that of the
    source."""
    found = []
    for group in groups:
        if group.first_channel == 0:
            found.append([])
        found[-1].append(group)
    for part in found:
        first, channels = part[0], [channel for group in part for channel in group.channels]
        if len(channels) != first.part_channels:
            raise Corrupt("a part that lacks channels")
        samples = [samples for group in part for samples in group.samples]
        if order and first.kind == "c3d/residuals":
            samples = [samples[order.index(column)] for column in range(len(samples))]
        width = 2 if first.form != FLOAT32 and not any(None in column for column in samples) else 4
        per_signal = 4 if first.kind == "c3d/model-outputs" else 1
        numbers = [(1, 1), (width, 1), (len(channels) // per_signal, 4), (first.samples_per_frame, 4)]
        numbers += [(first.first_frame, 8), (len(samples[0]) // first.samples_per_frame, 8)]
        if per_signal > 1:
            numbers += [(index, 4) for _, _, index, _, _ in channels[::per_signal]]
        front = b"".join(number.to_bytes(size, "little") for number, size in numbers)
        yield first.kind, front + b"".join(column(samples, first.form) for samples in samples)
