"""Stretches in order: their rows, times and blocks (docs/take-format.md, "STRETCH")."""

from . import summary as summaries
from .container import (
    CHANNELS, FOOTER, HEADER, ORDER, SAMPLED_GROUP, SAMPLES, STRETCH, SUMMARY, chunks, read_channels, read_header,
    read_order, restored,
)  # fmt: skip
from .cursor import Cursor
from .dense import Dense
from .errors import Corrupt
from .fast import Fast
from .frame import Group
from .lossless import Lossless
from .predictive import Predictive
from .samples import read_group, read_samples
from .spline import Spline
from .sync import Sync
from .timeline import Times

GROUP = 64
ROWS_MAX = {True: 1 << 17, False: 1 << 22}  # by whether the resampler is live
LIVE = {"dense", "fast", "lossless"}
PAYLOADS = {
    "dense": Dense,
    "fast": Fast,
    "lossless": Lossless,
    "lossless:predictive": Predictive,
    "spline": Spline,
    "sync": Sync,
}


class Take:
    """A decoded take."""

    def __init__(self):
        self.header = None
        self.channels = []
        self.order = None  # by row of the table: the column in the source, if it is another
        self.n_rows = 0
        self.times = []  # (row, ticks, arrival in 10 us, timecode) of the recorded rows
        self.lost = []  # (first row, rows, causes)
        self.finished = False
        self.ending = None  # (name, detail), if recorded
        self.tracks = {}  # by channel: {row: (position, kept)}
        self.groups = []  # of sampled channels
        self.stated_mm = 0.0
        self.stated_by_channel = {}  # the largest error of the blocks with samples of a channel, in mm


class Stretches:
    def __init__(self, header, take):
        kind = header.resampler.split(":")[0]
        # Variants of the others differ in their encoders only.
        name = header.resampler if header.resampler in PAYLOADS else kind
        if name not in PAYLOADS:
            raise Corrupt(f"no resampler is called {name}")
        self.make = PAYLOADS[name]
        self.rows_max = ROWS_MAX[kind in LIVE]
        self.tolerance_mm = header.tolerance_mm
        self.stretch_rows = header.stretch_rows
        self.take = take
        self.times = Times(header.tick_hz())
        self.next_row = 0
        self.next_number = 0
        self.groups = []

    def read(self, payload):
        cursor = Cursor(payload)
        head = cursor.byte()
        key, plain, alone, number = head & 1, head & 2, head & 4, head >> 3
        if number != self.next_number:
            raise Corrupt(f"stretch {self.next_number} modulo 32 is missing")
        self.next_number = (number + 1) % 32
        shape = 1 if plain else cursor.byte()
        if shape > 15 or shape & 3 == 2:
            raise Corrupt("a stretch of an unknown shape")
        from_row = cursor.varint() if key else self.next_row
        if from_row != self.next_row:
            raise Corrupt(f"stretches before row {from_row} are missing")
        n_rows = cursor.varint() if shape & 4 else self.stretch_rows
        if n_rows > self.rows_max:
            raise Corrupt(f"a stretch of {n_rows} rows")
        end = from_row + n_rows
        if shape & 1:
            end = self.time_line(cursor, key, from_row, n_rows, shape & 2)
        shared = cursor.take(cursor.varint()) if shape & 8 else b""
        blocks = []
        if alone:
            blocks = [cursor.rest()]
        while cursor.left():
            blocks.append(cursor.take(cursor.varint()))
        self.next_row = end
        self.take.n_rows = max(self.take.n_rows, end)
        self.decode(blocks, shared, end - n_rows, n_rows, bool(key))

    def time_line(self, cursor, key, from_row, n_rows, listed):
        """Reads the times of a stretch and returns the row after its last."""
        runs = [(n_rows, None)] if n_rows else []
        if listed:
            runs = []
            for _ in range(cursor.varint()):
                value = cursor.varint()
                runs.append((value >> 1, cursor.byte() if value & 1 else None))
        rows, row = [], from_row
        for n, causes in runs:
            if causes is None:
                rows += range(row, row + n)
            else:
                self.take.lost.append((row, n, causes))
            row += n
        if row - from_row < n_rows:
            raise Corrupt("runs shorter than their stretch")
        if key:
            self.times.begin()
            if rows:
                shift = cursor.byte()
                n, p, ticks, arrival = (cursor.varint() for _ in range(4))
                self.times.begin(rows[0], shift, n, p, ticks, arrival)
        if rows:
            self.take.times += self.times.read(cursor.take(cursor.varint()), rows, bool(key))
        return row

    def decode(self, blocks, shared, first_row, n_rows, key):
        self.groups += [None] * (len(blocks) - len(self.groups))
        for i, group in enumerate(self.groups):
            block = blocks[i] if i < len(blocks) else b""
            if group is None and block:
                group = self.groups[i] = Group(self.make(self.tolerance_mm), self.tolerance_mm)
            if group is None:
                continue
            for j, channel in enumerate(group.decode(block, shared, n_rows, key)):
                track = self.take.tracks.setdefault(i * GROUP + j, {})
                for row, present in enumerate(channel.present):
                    if present:
                        track[first_row + row] = (channel.positions[row], channel.kept[row])
                if any(channel.present):
                    before = self.take.stated_by_channel.get(i * GROUP + j, 0.0)
                    self.take.stated_by_channel[i * GROUP + j] = max(before, group.stated_mm)
            if block:
                self.take.stated_mm = max(self.take.stated_mm, group.stated_mm)


def restore_order(take):
    """Puts markers and their samples into the order of the source."""
    take.channels = restored(take.channels, take.order)
    column = dict(enumerate(take.order))
    take.tracks = {column.get(row, row): track for row, track in take.tracks.items()}
    take.stated_by_channel = {column.get(row, row): mm for row, mm in take.stated_by_channel.items()}


def read_take(data):
    """Decodes the bytes of an undamaged take, and compares its summary with them; one that ends after a complete chunk is
    read up to there."""
    take, stretches, summary = Take(), None, summaries.Summary()
    for kind, payload in chunks(data):
        if kind == HEADER:
            take.header = read_header(payload)
            take.channels = list(take.header.channels)
            stretches = Stretches(take.header, take)
        elif kind == ORDER and stretches:
            was_there, take.order = take.order is not None, read_order(payload)
            if take.header.device or take.n_rows or len(take.order) != len(take.header.channels) or was_there:
                raise Corrupt("an order of other markers")
        elif stretches is None:
            raise Corrupt("a take without a header in front")
        elif kind == CHANNELS:
            take.channels += read_channels(payload)
        elif kind == STRETCH:
            stretches.read(payload)
        elif kind == SAMPLED_GROUP:
            take.groups.append(read_group(payload))
        elif kind == SAMPLES:
            read_samples(payload, take.groups)
        elif kind == SUMMARY:
            summary = summaries.read_summary(payload, take.header.tolerance_mm)
            take.ending = summary.ending
        elif kind == FOOTER:
            take.finished = True
    if take.header is None:
        raise Corrupt("a take without a header")
    summaries.check(summary, take)
    if take.order:
        restore_order(take)
    return take
