"""Blocks of sampled channels: docs/sampled-channels.md."""

import math
import struct
from bisect import bisect_left

from .errors import Corrupt
from .float32 import f32, from_bits
from .range_coder import Bit, RangeDecoder

RAW = 0x80
CHANNELS_MAX = 64
FLOAT_MAX = 0x7F7FFFFF
LATTICE_MAX = 1 << 26
REACH = 1e12
NEIGHBOURS, DIFFERENCES, LAGS = 4, 8, 4
ORDER = DIFFERENCES + LAGS + 2 * NEIGHBOURS
FORGETTING, VARIANCE, VARIANCE_MAX, POWER_MAX = 0.9985, 1.0, 1e9, 1e30
INHERITED_VARIANCE = 10.0
RATES = (1 / 8, 1 / 32, 1 / 256)
# Average, width relative to it, degrees of freedom.
SHAPES = ((0, 1.2, 16), (0, 0.7, 4), (1, 0.5, 16), (1, 1.25, 16), (1, 0.8, 2), (2, 0.3, 4), (2, 1.25, 16), (2, 2.5, 2))
ROOTS = {2: 1.4142135623730951, 4: 2.0, 16: 4.0}
SPREAD, SMALLEST = 0.01, 1e-12
OTHER, REPEAT, LINE, MODE = range(4)


def coefficients():
    rows, coefficient = [], 1.0
    for power in range(8):
        rows.append([coefficient if 2 * power < degrees else 0.0 for _, _, degrees in SHAPES])
        coefficient *= (2 * power + 1) / (2 * power + 2)
    return rows


COEFFICIENTS = coefficients()


def bits_of(value):
    return struct.unpack("<I", struct.pack("<f", value))[0]


def ordered(bits):
    signed = bits - (1 << 32) if bits >> 31 else bits
    return signed ^ 0x7FFFFFFF if signed < 0 else signed


def bits_from_ordered(number):
    return (number ^ 0x7FFFFFFF if number < 0 else number) & 0xFFFFFFFF


def is_finite(bits):
    return bits & 0x7F800000 != 0x7F800000


def whole(value):
    """Truncated to 64 bits; NaN is 0."""
    if math.isnan(value):
        return 0
    return int(min(max(value, -(2.0**63)), 2.0**63 - 1024))


class Cells:
    def __init__(self):
        self.form, self.decimals = ("float", 0), None

    def bounds(self):
        kind = self.form[0]
        if kind == "float":
            return -(FLOAT_MAX >> self.form[1]), FLOAT_MAX >> self.form[1]
        if kind == "lattice":
            return -LATTICE_MAX, LATTICE_MAX
        return 0, len(self.form[1]) - 1

    def position(self, cell):
        kind = self.form[0]
        if kind == "float":
            magnitude = from_bits(abs(cell) << self.form[1])
            return -magnitude if cell < 0 else magnitude
        if kind == "lattice":
            return cell * self.form[1] + self.form[2]
        return from_bits(bits_from_ordered(self.form[1][cell]))

    def value(self, cell):
        position = self.position(cell)
        if self.decimals is None:
            return f32(position)
        ten = 10.0**self.decimals
        rounded = position * ten
        rounded = math.copysign(float(round(rounded)), rounded)
        return f32(rounded / ten)

    def border(self, cell):
        return (self.position(cell) + self.position(cell + 1)) / 2.0

    def nearest(self, value):
        first, last = self.bounds()
        kind = self.form[0]
        if kind == "float":
            zeros = self.form[1]
            bits = bits_of(f32(value))
            cell = ((bits & 0x7FFFFFFF) + ((1 << zeros) >> 1)) >> zeros
            if value < 0 and bits & 0x7FFFFFFF:
                cell = -cell
        elif kind == "lattice":
            cell = (value - self.form[2]) / self.form[1]
            cell = whole(cell + (-0.5 if cell < 0 else 0.5))
        else:
            above = bisect_left(self.form[1], value, key=lambda entry: from_bits(bits_from_ordered(entry)))
            low, high = max(above - 1, 0), min(above, last)
            cell = low if value < (self.position(low) + self.position(high)) / 2.0 else high
        return min(max(cell, first), last)

    def is_even(self, first, last):
        if self.form[0] != "float":
            return True
        return (first << self.form[1]) >> 23 == (last << self.form[1]) >> 23

    def check(self):
        kind, good = self.form[0], True
        if kind == "lattice":
            _, quantum, offset = self.form
            good = quantum > 1e-45 and LATTICE_MAX * quantum < 3e38 and -quantum <= offset <= quantum
        elif kind == "palette":
            entries = self.form[1]
            good = all(a < b for a, b in zip(entries, entries[1:]))
            good = good and all(is_finite(bits_from_ordered(entry)) for entry in entries)
        elif kind == "float":
            good = self.form[1] < 31
        if not good or (self.decimals or 0) > 9:
            raise Corrupt("a representation of no values")


class Predictor:
    def __init__(self, value):
        self.weights = [0.0] * ORDER
        self.differences = [value] + [0.0] * (DIFFERENCES - 1)
        self.changes = [0.0] * (DIFFERENCES + LAGS - 1)
        self.mean = value
        self.n_values = DIFFERENCES
        self.reset_inverse()

    def start_like(self, other):
        """Takes over what another channel learnt from its own past."""
        own = DIFFERENCES + LAGS
        self.n_values = 1
        self.weights[:own] = other.weights[:own]
        for i in range(own):
            for j in range(own):
                self.inverse[i][j] = other.inverse[i][j] * INHERITED_VARIANCE
            self.largest = max(self.largest, self.inverse[i][i])

    def restart(self, value):
        """A new past, behind a gap."""
        self.differences = [value] + [0.0] * (DIFFERENCES - 1)
        self.changes = [0.0] * (DIFFERENCES + LAGS - 1)
        self.mean = value
        self.n_values = 1

    def reset_inverse(self):
        self.largest = VARIANCE
        self.inverse = [[VARIANCE if i == j else 0.0 for j in range(ORDER)] for i in range(ORDER)]

    def predict(self, beside):
        self.inputs = [self.differences[0] - self.mean, *self.differences[1:], *self.changes[DIFFERENCES - 1 :], *beside]
        sums = [0.0] * 4
        for i in range(ORDER):
            sums[i % 4] += self.inputs[i] * self.weights[i]
        return self.differences[0] + ((sums[0] + sums[1]) + (sums[2] + sums[3]))

    def push(self, value):
        difference = value
        for i in range(DIFFERENCES):
            before, self.differences[i] = self.differences[i], difference
            difference -= before
        self.n_values = min(self.n_values + 1, DIFFERENCES)
        self.differences[self.n_values :] = [0.0] * (DIFFERENCES - self.n_values)
        self.changes = [self.differences[1]] + self.changes[:-1]
        self.mean += (value - self.mean) * (1.0 / 256.0)

    def learn(self, error):
        forgetting = FORGETTING if self.largest < VARIANCE_MAX else 1.0
        gains = [0.0] * ORDER
        for row, value in zip(self.inverse, self.inputs):
            for i in range(ORDER):
                gains[i] += row[i] * value
        power = forgetting
        for gain, value in zip(gains, self.inputs):
            power += gain * value
        if not forgetting <= power < POWER_MAX:
            self.reset_inverse()
            return
        step = error / power
        for i in range(ORDER):
            self.weights[i] += gains[i] * step
        shrink, grow = 1.0 / power, 1.0 / forgetting
        self.largest = 0.0
        for i, row in enumerate(self.inverse):
            own = gains[i]
            for j in range(ORDER):
                row[j] = (row[j] - own * gains[j] * shrink) * grow
            self.largest = max(self.largest, row[i])


class Distribution:
    def __init__(self, like=None):
        self.averages = list(like.averages) if like else [1.0] * 3
        self.weights = list(like.weights) if like else [1.0 / len(SHAPES)] * len(SHAPES)
        self.set_widths()

    def set_widths(self):
        self.inverse = [1.0 / (self.averages[a] * (width * ROOTS[degrees])) for a, width, degrees in SHAPES]

    def parts(self, error):
        result = []
        for part, inverse in enumerate(self.inverse):
            u = error * inverse
            c = 1.0 / (1.0 + u * u)
            total = COEFFICIENTS[7][part]
            for power in range(6, -1, -1):
                total = total * c + COEFFICIENTS[power][part]
            result.append(0.5 + 0.5 * (u * math.sqrt(c) * total))
        return result

    def below(self, error):
        sums = [0.0] * 4
        for i, (part, weight) in enumerate(zip(self.parts(error), self.weights)):
            sums[i % 4] += part * weight
        return (sums[0] + sums[1]) + (sums[2] + sums[3])

    def learn(self, low, high, error):
        narrow = self.averages[1] * (1.0 / 64.0)
        if high - low < narrow:
            low, high = error - 0.5 * narrow, error + 0.5 * narrow
        below, through = self.parts(low), self.parts(high)
        likelihoods = [w * (h - b + 1e-12) for w, h, b in zip(self.weights, through, below)]
        total = 0.0
        for likelihood in likelihoods:
            total += likelihood
        share = (1.0 - SPREAD) / total
        self.weights = [likelihood * share + SPREAD / len(SHAPES) for likelihood in likelihoods]
        for i, rate in enumerate(RATES):
            self.averages[i] += (abs(error) - self.averages[i]) * rate
            self.averages[i] = max(self.averages[i], SMALLEST)
        self.set_widths()


def unit(bits, per_unit):
    value = from_bits(bits) * per_unit
    return 0.0 if math.isnan(value) else min(max(value, -REACH), REACH)


class Track:
    """The state of a channel. Samples are the bits of float32."""

    def __init__(self):
        self.cells = Cells()
        self.distribution, self.across_gaps = Distribution(), Distribution()
        self.last = self.last_before = (0, 0)
        self.is_started = False
        self.events = self.parity = 0
        self.exponent, self.beside = 0, []

    def start(self, bits, like=None):
        self.is_started, self.parity, self.last = True, 1, (bits, bits)
        self.predictor = Predictor(unit(bits, 2.0**-self.exponent))
        if like:
            self.predictor.start_like(like.predictor)
            self.distribution = Distribution(like.distribution)
            self.across_gaps = Distribution(like.across_gaps)


class Halving:
    def __init__(self, coder, track, distribution, centre):
        self.coder, self.cells, self.distribution = coder, track.cells, distribution
        self.centre, self.per_unit = centre, 2.0**-track.exponent
        self.excluded = []

    def below(self, cell):
        return self.distribution.below((self.cells.border(cell - 1) - self.centre) * self.per_unit)

    def exclude(self, samples):
        first, last = self.cells.bounds()
        for bits in samples:
            if not is_finite(bits):
                continue
            cell = self.cells.nearest(from_bits(bits))
            known = any(cell == other for other, _ in self.excluded)
            if bits_of(self.cells.value(cell)) == bits and not known:
                below = self.below(cell) if cell > first else 0.0
                through = self.below(cell + 1) if cell < last else 1.0
                self.excluded.append((cell, through - below))

    def mass(self, first, last, below, through):
        mass = through - below
        for cell, probability in self.excluded:
            if first <= cell <= last:
                mass -= probability
        return max(mass, 0.0)

    def decide(self, middle):
        border = self.below(middle)
        lower = (self.first, middle - 1, self.low, border)
        upper = (middle, self.last, border, self.high)
        masses = self.mass(*lower), self.mass(*upper)
        total, probability = masses[0] + masses[1], 1 << 15
        if total > 1e-13:
            probability = min(max(int(masses[0] / total * 65536.0), 16), 65520)
        is_upper = self.coder.split(probability)
        self.first, self.last, self.low, self.high = upper if is_upper else lower
        return is_upper

    def code(self):
        self.first, self.last = self.cells.bounds()
        self.low, self.high = 0.0, 1.0
        near = self.cells.nearest(self.centre)
        is_upper = near == self.first or self.decide(near)
        step = self.distribution.averages[1] / self.per_unit * 0.5
        while self.first < self.last:
            if is_upper:
                middle = max(self.cells.nearest(self.centre + step), self.first) + 1
                if middle > self.last or not self.decide(middle):
                    break
            else:
                middle = min(self.cells.nearest(self.centre - step), self.last)
                if middle <= self.first or self.decide(middle):
                    break
            step *= 2.0
        return self.narrow(min(self.distribution.averages) / self.per_unit)

    def narrow(self, width):
        while self.first < self.last:
            low, high = self.cells.position(self.first), self.cells.position(self.last)
            if high - low < width * 0.25 and self.cells.is_even(self.first, self.last):
                return self.uniform()
            middle = self.cells.nearest((low + high) * 0.5)
            self.decide(min(max(middle, self.first + 1), self.last))
        return self.first

    def uniform(self):
        first = self.first
        while True:
            n = self.last - first + 1
            log = n.bit_length() - 1
            half = 1 << log
            if half < n and self.coder.split(min(max((half << 16) // n, 1), 65535)):
                first += half
                continue
            return first + self.coder.plain(log)


class SampledDecoder:
    """Decodes the blocks of a group, in order."""

    # Whether contexts of events depend on the channel before.
    has_previous = True

    def __init__(self, channels_max=CHANNELS_MAX, index_bits=6):
        self.n_channels = None
        self.channels_max, self.index_bits = channels_max, index_bits

    def reset(self):
        self.tracks = [Track() for _ in range(self.channels_max)]
        self.flags = [Bit() for _ in range(16)]
        self.logs = [Bit() for _ in range(33)]
        self.quantum = 1.0
        self.lines, self.repeats, self.modes = ([Bit() for _ in range(384)] for _ in range(3))
        self.corrections = [Bit() for _ in range(36)]

    def decode(self, block, n_rows, key):
        """The bits of each channel's samples."""
        n_channels, is_raw = block[0] & ~RAW, block[0] & RAW
        if not 1 <= n_channels <= CHANNELS_MAX or not key and n_channels != self.n_channels:
            raise Corrupt("a number of channels")
        self.n_channels = n_channels
        if key or is_raw:
            self.reset()
        if is_raw:
            if len(block) != 1 + 4 * n_channels * n_rows:
                raise Corrupt("samples as they are, of another number")
            words = struct.unpack(f"<{n_channels * n_rows}I", block[1:])
            return [list(words[i * n_rows : (i + 1) * n_rows]) for i in range(n_channels)]
        self.coder, self.done = RangeDecoder(block[1:]), []
        for channel in range(n_channels):
            self.done.append([])
            self.read_channel(channel, range(n_rows), self.done[channel])
        self.coder.finish()
        return self.done

    def read_channel(self, channel, rows, samples, behind_gaps=(), like=None):
        """Appends the bits of the samples in these rows."""
        track = self.tracks[channel]
        self.read_head(track)
        if any(index >= channel for index in track.beside):
            raise Corrupt("a reference that does not come before its channel")
        self.rows = rows
        if track.cells.form[0] == "stored":
            samples.extend(self.coder.plain(32) for _ in rows)
            track.start(samples[-1])
            return
        if not track.is_started:
            samples.append(self.coder.plain(32))
            track.start(samples[0], like)
        track.last_before = track.last
        while len(samples) < len(rows):
            sample = self.read_sample(channel, track, len(samples), len(samples) in behind_gaps)
            samples.append(sample)
            track.last = sample, track.last[0]

    def number(self):
        if self.coder.bit(self.flags[12]):
            return from_bits(self.coder.plain(32))
        return struct.unpack("<d", struct.pack("<Q", self.coder.plain(64)))[0]

    def read_head(self, track):
        coder, flags = self.coder, self.flags
        if track.is_started and coder.bit(flags[0]):
            return
        if not track.is_started:
            exponent = coder.plain(8)
            track.exponent = exponent - 256 if exponent >> 7 else exponent
            n_beside = coder.plain(3)
            if track.exponent <= -127 or n_beside > NEIGHBOURS:
                raise Corrupt("a unit out of range, or too many references")
            track.beside = [coder.plain(self.index_bits) for _ in range(n_beside)]
        bits = [coder.bit(flags[1 + i]) for i in range(7)]
        track.repeats, track.has_lines = bits[0:2], bits[2:4]
        track.past = ("events" if bits[5] else "cells") if bits[4] else "all"
        track.corrects = bits[6]
        track.mode = coder.plain(32) if coder.bit(flags[8]) else None
        track.cells = Cells()
        track.cells.decimals = coder.plain(4) if coder.bit(flags[15]) else None
        if not coder.bit(flags[9]):
            track.cells.form = ("float", coder.plain(5))
        elif not coder.bit(flags[10]):
            if not coder.bit(flags[13]):
                self.quantum = self.number()
            offset = self.number() if coder.bit(flags[14]) else 0.0
            track.cells.form = ("lattice", self.quantum, offset)
        elif not coder.bit(flags[11]):
            track.cells.form = ("palette", self.read_palette())
        else:
            track.cells.form = ("stored",)
        track.cells.check()

    def read_palette(self):
        n = self.coder.plain(12) + 1
        first = self.coder.plain(32)
        entries = [first - (1 << 32) if first >> 31 else first]
        while len(entries) < n:
            log = 0
            while self.coder.bit(self.logs[log]):
                log += 1
                if log == 32:
                    raise Corrupt("a palette out of range")
            entries.append(entries[-1] + (1 << log | self.coder.plain(log)))
            if entries[-1] >> 31:
                if entries[-1] >= 0:
                    raise Corrupt("a palette out of range")
        return entries

    def at(self, channel, row, back):
        """What a channel that is done held at a sample, or `back` samples before."""
        if row >= back:
            return self.done[channel][self.rows[row - back]]
        return self.tracks[channel].last_before[min(back - row - 1, 1)]

    def read_sample(self, channel, track, row, is_behind_gap):
        parity, per_unit = track.parity, 2.0**-track.exponent
        track.parity ^= 1
        context = (track.events & 63) * 2 + parity
        previous = 0
        if self.has_previous and channel and (track.repeats[parity] or track.mode is not None):
            previous = 1 + (self.at(channel - 1, row, 0) == self.at(channel - 1, row, 1))
        excluded, events = [], []
        if track.has_lines[parity]:
            line = f32(2.0 * from_bits(track.last[0]) - from_bits(track.last[1]))
            line = bits_of(line) if math.isfinite(line) else 0x7FC00000
            events.append((self.lines[context], line, LINE))
        if track.repeats[parity]:
            events.append((self.repeats[context * 3 + previous], track.last[0], REPEAT))
        if track.mode is not None:
            events.append((self.modes[context * 3 + previous], track.mode, MODE))
        for model, sample, event in events:
            if self.coder.bit(model):
                track.events = track.events << 2 | event
                if track.past != "cells":
                    track.predictor.push(unit(sample, per_unit))
                return sample
            excluded.append(sample)
        return self.read_cell(track, row, excluded, is_behind_gap)

    def read_cell(self, track, row, excluded, is_behind_gap):
        per_unit = 2.0**-track.exponent
        beside = []
        for other in track.beside:
            of_other = 2.0 ** -self.tracks[other].exponent
            now, then, before = (unit(self.at(other, row, back), of_other) for back in range(3))
            beside += [now - then, then - before]
        beside += [0.0] * (2 * NEIGHBOURS - len(beside))
        predicted = track.predictor.predict(beside)
        if is_behind_gap or not -REACH < predicted < REACH:
            predicted = track.predictor.differences[0]
        distribution = track.across_gaps if is_behind_gap else track.distribution
        halving = Halving(self.coder, track, distribution, predicted * 2.0**track.exponent)
        if not track.corrects:
            halving.exclude(excluded)
        cell = halving.code()
        bits = bits_of(track.cells.value(cell))
        if track.corrects:
            corrected = ordered(bits) + self.correction()
            if not -(1 << 31) <= corrected < 1 << 31:
                raise Corrupt("a sample out of range")
            bits = bits_from_ordered(corrected)
        first, last = track.cells.bounds()
        low = track.cells.border(cell - 1) if cell > first else -1e39
        high = track.cells.border(cell) if cell < last else 1e39
        value = unit(bits, per_unit) if is_finite(bits) else predicted
        distribution.learn(low * per_unit - predicted, high * per_unit - predicted, value - predicted)
        if is_behind_gap:
            track.predictor.restart(value)
        else:
            track.predictor.learn(value - predicted)
            if track.past != "events":
                track.predictor.push(value)
        track.events <<= 2
        return bits

    def correction(self):
        if not self.coder.bit(self.corrections[0]):
            return 0
        is_negative = self.coder.bit(self.corrections[1])
        log = 0
        while self.coder.bit(self.corrections[2 + log]):
            log += 1
            if log == 33:
                raise Corrupt("a correction out of range")
        magnitude = 1 << log | self.coder.plain(log)
        return -magnitude if is_negative else magnitude
