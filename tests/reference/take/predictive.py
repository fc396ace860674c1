"""`lossless:predictive`: positions as sampled channels (docs/sampled-channels.md, "Positions")."""

from .columns import History, read_channel
from .cursor import Cursor
from .errors import Corrupt
from .float32 import from_bits
from .range_coder import RangeDecoder
from .sampled import SampledDecoder, is_finite

AXES, MARKERS = 3, 64


class PositionsDecoder(SampledDecoder):
    """The channels of a group, three of each marker."""

    has_previous = False

    def __init__(self):
        super().__init__(channels_max=AXES * MARKERS, index_bits=8)
        self.reset()

    def read_positions(self, payload, channels, continues):
        """Fills the positions; `continues` says which markers had a sample in the row before."""
        self.coder, self.done = RangeDecoder(payload), []
        for marker, channel in enumerate(channels):
            rows, behind_gaps = present_rows(channel.present, continues[marker])
            continues[marker] = channel.present[-1]
            axes = [self.read_axis(AXES * marker + axis, rows, behind_gaps, len(channel.present)) for axis in range(AXES)]
            for row in rows:
                channel.positions[row] = tuple(from_bits(held[row]) for held in axes)
                channel.kept[row] = True
        self.coder.finish()

    def read_axis(self, channel, rows, behind_gaps, n_rows):
        """What the channel holds in every row, as bits."""
        track, samples = self.tracks[channel], []
        if rows:
            of = channel - AXES if channel >= AXES else channel - 1
            like = self.tracks[of] if of >= 0 and self.tracks[of].is_started else None
            self.read_channel(channel, rows, samples, behind_gaps, like)
        else:
            track.last_before = track.last
        if not all(map(is_finite, samples)):
            raise Corrupt("a value not finite")
        held, last, samples = [], track.last_before[0], dict(zip(rows, samples))
        for row in range(n_rows):
            last = samples.get(row, last)
            held.append(last)
        self.done.append(held)
        return held


def present_rows(present, was_present):
    """The rows with a sample, and the indices of those behind gaps."""
    rows, behind_gaps = [], set()
    for row, is_present in enumerate(present):
        if is_present:
            if not was_present:
                behind_gaps.add(len(rows))
            rows.append(row)
        was_present = is_present
    return rows, behind_gaps


class Predictive:
    """The payloads of a group."""

    EXACT = True

    def __init__(self, _tolerance_mm):
        self.reset()

    def reset(self):
        self.decoder = PositionsDecoder()
        self.break_off()

    def break_off(self):
        self.continues = [False] * MARKERS

    def decode(self, payload, _shared, channels):
        cursor = Cursor(payload)
        coding = cursor.byte()
        if coding == 1:
            self.decoder.read_positions(cursor.rest(), channels, self.continues)
        elif coding == 0:
            for channel in channels:
                if any(channel.present):
                    read_channel(cursor, channel, [History() for _ in range(AXES)])
            cursor.finish()
            self.reset()
        else:
            raise Corrupt("an unknown coding of samples")
