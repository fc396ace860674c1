"""The times of the rows: docs/take-format.md, "The time line"."""

from .columns import MASK, signed
from .errors import Corrupt
from .range_coder import Bit, RangeDecoder

STRAY = 1 << 47


def clamp(value, limit=STRAY):
    return max(-limit, min(limit, value))


class Number:
    """The adaptive model of one kind of number."""

    def __init__(self, odds):
        self.nonzero = [Bit(128) for _ in range(21)]
        self.nonzero[10] = Bit(odds)
        self.negative = [Bit() for _ in range(21)]
        self.longer = [[Bit() for _ in range(12)] for _ in range(6)]
        self.exponent = [Bit() for _ in range(63)]
        self.last = self.before = self.activity = 0

    def read(self, coder):
        context = 3 * (clamp(self.last, 3) + 3) + clamp(self.before, 1) + 1
        value = 0
        if coder.bit(self.nonzero[context]):
            negative = coder.bit(self.negative[context])
            magnitude = self.magnitude(coder)
            value = signed(-magnitude if negative else magnitude)
        self.activity += 32 * min(31, abs(value)) - (self.activity >> 3)
        self.before, self.last = self.last, value
        return value

    def magnitude(self, coder):
        longer = self.longer[sum(limit <= self.activity for limit in (12, 48, 128, 320, 1024))]
        for i in range(12):
            if not coder.bit(longer[i]):
                return i + 1
        e = 0
        while e < 63 and coder.bit(self.exponent[e]):
            e += 1
        return 12 + (1 << e) + coder.plain(e)


class Timecodes:
    def __init__(self):
        self.code, self.held, self.top = None, 0, 255
        self.present = [Bit(0), Bit(255)]
        self.same = [Bit(128) for _ in range(17)]
        self.next = [Bit(240), Bit(16)]
        self.second = [Bit(240), Bit(240)]

    def read(self, coder):
        if not coder.bit(self.present[self.code is not None]):
            self.code = None
            return None
        old = self.code or (0, 0, 0, 0)
        if coder.bit(self.same[self.held]):
            self.held = min(self.held + 1, 16)
            self.code = old
            return old
        self.held = 0
        hours, minutes, seconds, frames = old
        at_top = frames == self.top
        if coder.bit(self.next[at_top]):
            self.code = (hours, minutes, seconds, (frames + 1) & 255)
        elif coder.bit(self.second[at_top]):
            self.top = frames
            self.code = self.one_second_more(hours, minutes, seconds)
        else:
            self.code = tuple(coder.plain(32).to_bytes(4, "big"))
        return self.code

    @staticmethod
    def one_second_more(hours, minutes, seconds):
        if (hours, minutes, seconds) == (23, 59, 59):
            return (0, 0, 0, 0)
        if (minutes, seconds) == (59, 59):
            return ((hours + 1) & 255, 0, 0, 0)
        if seconds == 59:
            return (hours, (minutes + 1) & 255, 0, 0)
        return (hours, minutes, (seconds + 1) & 255, 0)


class Times:
    """State that continues from stretch to stretch."""

    def __init__(self, tick_hz):
        self.tick_hz = tick_hz or 1
        self.begin()

    def begin(self, row=0, shift=0, n=1, p=0, ticks=0, arrival=0):
        if shift > 24 or not 1 <= n <= 65535:
            raise Corrupt("an anchor that makes no sense")
        self.row, self.shift, self.n, self.p = row, shift, n, p
        self.ticks, self.part, self.last = ticks, n // 2, arrival
        self.from_ticks, self.from_arrival = ticks, arrival
        self.offset = self.slope = self.together = 0
        self.errors, self.steps = Number(4), Number(32)
        self.with_last = [Bit(2)] + [Bit(128) for _ in range(7)]
        self.timecodes = Timecodes()

    def read(self, data, rows, anchored):
        """(row, ticks, arrival in 10 us, timecode or None) of the recorded rows."""
        coder = RangeDecoder(data)
        times = []
        for i, row in enumerate(rows):
            if not (anchored and i == 0):
                self.clocks(coder, row - self.row)
                self.row = row
            times.append((row, self.ticks, self.last, self.timecodes.read(coder)))
        coder.finish()
        return times

    def clocks(self, coder, rows):
        total = self.part + self.p * rows
        self.part = total % self.n
        error = self.errors.read(coder)
        self.ticks = (self.ticks + total // self.n + error) & MASK
        if error:
            self.part = 0 if error > 0 else self.n - 1
        self.offset = clamp(self.offset + clamp(self.slope * rows, MASK >> 1))
        if coder.bit(self.with_last[self.together]):
            self.together = min(self.together + 1, 7)
            return
        self.together = 0
        passed = signed(self.ticks - self.from_ticks) * 100_000 // self.tick_hz
        steps = self.steps.read(coder)
        self.last = (self.from_arrival + passed + (self.offset >> 16) + (steps << self.shift)) & MASK
        if abs(steps) > 64:
            self.from_ticks, self.from_arrival, self.offset = self.ticks, self.last, 0
        else:
            by = steps << self.shift + 16
            self.offset = clamp(self.offset + (by >> 4))
            self.slope = clamp(self.slope + (by >> 12))
