"""`dense`: docs/codec.md, "dense". Rows of a channel are list indices; the first row of the block has index MEMORY."""

import math
import struct

from ..errors import Corrupt
from ..range_coder import RangeDecoder
from . import layout as ctx
from .lattice import FINE, NORMAL
from .track import MEMORY
from .walk import Walk

# Probability that a block is not stored raw as a whole, in 2^-16.
CODED = 65536 - 8
FLOATS = struct.Struct("<f")


class Dense:
    """The payloads of a group."""

    EXACT = False

    def __init__(self, tolerance_mm):
        self.unit_mm = tolerance_mm / 256
        self.walk = Walk(self.unit_mm)

    def reset(self):
        self.walk.reset()

    def break_off(self):
        self.walk.break_off()

    def decode(self, payload, _shared, channels):
        coder = RangeDecoder(payload)
        if coder.split(CODED):
            self.walk.reset()
            for channel in channels:
                stored(coder, channel)
            coder.finish()
            return
        present = [channel.present for channel in channels]
        for i, channel in enumerate(channels):
            if any(channel.present) and self.is_raw(coder, self.walk.tracks[i]):
                stored(coder, channel)
                present[i] = None
        self.walk.block(coder, len(channels[0].present), present, self.settle(channels))
        coder.finish()

    def is_raw(self, coder, track):
        """Decodes how a sampled channel is stored in this block."""
        model = self.walk.model
        raw = model.single(coder, ctx.RAW + track.was_raw)
        track.was_raw = 1 + raw
        if not raw:
            fine = model.single(coder, ctx.FINE + track.was_fine)
            track.was_fine = 1 + fine
            track.fineness = FINE if fine else NORMAL
        return raw

    def settle(self, channels):
        unit_mm, pack, unpack = self.unit_mm, FLOATS.pack, FLOATS.unpack

        def settle(channel, row, point, kept):
            position = tuple(unpack(pack(units * unit_mm))[0] for units in point)
            channels[channel].positions[row - MEMORY] = position
            channels[channel].kept[row - MEMORY] = kept

        return settle


def stored(coder, channel):
    """Decodes a channel stored raw."""
    for row, present in enumerate(channel.present):
        if present:
            bits = struct.pack("<3I", *(coder.plain(32) for _ in range(3)))
            position = struct.unpack("<3f", bits)
            if not all(map(math.isfinite, position)):
                raise Corrupt("a stored coordinate is not finite")
            channel.positions[row] = position
            channel.kept[row] = True
