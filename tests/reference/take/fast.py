"""`fast`: dyadic interpolation in float32, fixed tables (docs/codec.md, "fast")."""

import math

from .columns import read_channel
from .cursor import Cursor
from .errors import Corrupt
from .fast_run import Memory, mul, run
from .float32 import f32
from .tans import LOG_STATES, Bits

RAW = 4


class Fast:
    """The payloads of a group."""

    EXACT = False

    def __init__(self, tolerance_mm):
        self.tolerance = tolerance_mm
        self.cap = mul(f32(tolerance_mm), 1024.0)
        self.reset()

    def reset(self):
        self.memories = [Memory() for _ in range(64)]

    def break_off(self):
        for memory in self.memories:
            memory.known = 0

    def decode(self, payload, _shared, channels):
        sampled = [i for i, channel in enumerate(channels) if any(channel.present)]
        bits = Bits(payload)
        modes = dict.fromkeys(sampled, 0)
        cursor = Cursor(payload)
        if bits.take(1):
            for i in sampled:
                modes[i] = cursor.byte()
                if modes[i] > RAW:
                    raise Corrupt("unknown mode")
            for i in sampled:
                if modes[i] == RAW:
                    read_channel(cursor, channels[i])
        if any(mode != RAW for mode in modes.values()):
            bits.state = bits.take(LOG_STATES)
        for i, memory in enumerate(self.memories):
            if modes.get(i, RAW) == RAW:
                memory.known = 0
            else:
                self.channel(bits, memory, modes[i], channels[i])
        if bits.left != 8 * cursor.at or bits.state != 0:
            raise Corrupt("residuals left over")

    def channel(self, bits, memory, mode, channel):
        step = f32(self.tolerance * (2.0 / 1.7320508075688772 * (1.0 - 1.0 / 512.0)) / (1 << mode))
        end = 0
        for start, end in channel.runs():
            if start != 0:
                memory.known = 0
            points, flags = run(bits, memory, step, self.cap, end - start)
            if not all(math.isfinite(value) for point in points for value in point):
                raise Corrupt("a position beyond every coordinate")
            channel.positions[start:end] = map(tuple, points)
            channel.kept[start:end] = flags
        if end != len(channel.present):
            memory.known = 0
