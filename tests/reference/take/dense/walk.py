"""The order in which the rows of a group are coded."""

from . import row as syntax
from .code import Rows
from .lattice import CUBIC, UNITS, distance
from .layout import LEVELS, ORIGIN_KIND, SPAN
from .origin import Ways
from .row import Surroundings
from .taps import Site
from .track import MEMORY, End

# Number of rows of a level for which the partners keep the same shares.
TOGETHER = 8


class Walk(Rows):
    def __init__(self, unit_mm):
        super().__init__()
        self.unit_mm = unit_mm
        self.present = []
        self.first_row = 0  # since the key block

    def reset(self):
        super().reset()
        self.first_row = 0

    def break_off(self):
        for track in self.tracks:
            track.known = [False] * len(track.known)

    def block(self, coder, n_rows, present, settled):
        """`present` by channel, None for a raw one; `settled` is called with every row."""
        self.coder, self.present, self.settled = coder, present, settled
        for track in self.tracks:
            track.begin(n_rows)
        before = MEMORY - 1
        while before + 1 < MEMORY + n_rows:
            last = min(before + SPAN, MEMORY + n_rows - 1)
            self.span(before, last)
            before = last
        for track in self.tracks:
            track.finish(n_rows)
        self.first_row += n_rows

    def span(self, before, last):
        """The rows after `before`, up to and including `last`."""
        n = len(self.present)
        self.before = before
        self.weave.begin()
        runs = sorted(self.runs(before, last))
        solved = set()
        for zero, channel, end in runs:
            track = self.tracks[channel]
            if zero > before:
                self.origin(channel, zero)
            else:
                track.run_start = max(track.run_start, before + 1 - MEMORY)
            if channel not in solved:
                solved.add(channel)
                self.look_around(channel, n)
            if end > zero:
                self.anchor(channel, zero, end)
            track.end = End(self.first_row + end - MEMORY, track.points[end])
        runs.sort(key=lambda run: (run[1], run[0]))
        for level in reversed(range(LEVELS)):
            for zero, channel, end in runs:
                self.level(1 << level, channel, zero, end)
        for zero, channel, _ in runs:
            if zero > before:
                self.tracks[channel].run_start = zero
        self.weave.end(n)

    def runs(self, before, last):
        """(first row, or the row before the span if the run continues from there; channel; last row)."""
        for channel, present in enumerate(self.present):
            row = before + 1
            while present is not None and row <= last:
                if not present[row - MEMORY]:
                    row += 1
                    continue
                goes_on = row == before + 1 and self.tracks[channel].known[before]
                zero = before if goes_on else row
                while row < last and present[row + 1 - MEMORY]:
                    row += 1
                yield zero, channel, row
                row += 2

    def look_around(self, channel, n):
        """Updates what depends on the channel's position among the others."""
        own = self.placed(channel)
        for k in range(channel if own else 0):
            other = self.placed(k)
            if other:
                mm = distance(own, other) * UNITS * self.unit_mm
                self.weave.place(channel, k, mm)
        self.lengths.choose(channel, self.weave.kernel[channel])
        self.weave.solve(channel, n)

    def placed(self, channel):
        track = self.tracks[channel]
        for row in (self.before, self.before + 1):
            if track.known[row]:
                return track.points[row]
        return None

    def start_of(self, channel, zero):
        return zero if zero > self.before else self.tracks[channel].run_start

    def level(self, stride, channel, zero, end):
        start = self.start_of(channel, zero)
        first = (zero - self.before) // (2 * stride) * (2 * stride) + stride + self.before
        if first <= zero:
            first += 2 * stride
        track, kind = self.tracks[channel], 4 + stride.bit_length() - 1
        if first < end:
            self.lengths.begin(channel, kind)
        for i, at in enumerate(range(first, end, 2 * stride)):
            if i % TOGETHER == 0:
                shares = self.lengths.shares_of(channel, kind)
            site = Site(at, stride, start, zero, end)
            point, bend, side = site.expect(track.points)
            around = Surroundings(
                kind,
                track.steps_from(start, site.left),
                track.steps_from(start, site.right),
                track.steps_from(start, at - 2 * stride),
                track.steps_from(start, at - 4 * stride),
                bend,
                side,
            )
            self.code(channel, at, point, around, site.left, site.right, shares)

    def origin(self, channel, at):
        """Decodes the first row of a run."""
        ways = Ways(self.tracks, channel, at, self.first_row, self.present)
        step = self.tracks[channel].fineness[CUBIC]
        choice, way, taken = ways.read(self.coder, self.model)
        if taken is not None:
            self.tracks[taken].end.taken = True
        steps = syntax.origin(self.coder, self.model, way)
        point = tuple(p + s * step for p, s in zip(ways.points[choice], steps))
        self.settle(channel, at, ORIGIN_KIND, point, steps, True)

    def anchor(self, channel, zero, end):
        """The last row of a run within the span."""
        start, rows = self.start_of(channel, zero), end - zero
        track = self.tracks[channel]
        expected, guesses = track.anchor.guess(track.points[start : zero + 1], rows)
        kind = 1 if rows >= 17 else 2 if rows >= 5 else 3
        around = Surroundings(kind, track.steps_from(start, zero))
        shares = self.lengths.shares_of(channel, kind)
        self.code(channel, end, expected, around, zero, zero, shares)
        track.anchor.score(guesses, track.points[end])
