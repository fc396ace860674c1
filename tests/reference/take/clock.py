"""CLOCK, and the clock line fitted to its observations: docs/take-format.md and docs/clock.md."""

from dataclasses import dataclass

from .container import Record
from .cursor import Cursor

KIND = 0x8C
MASK = (1 << 64) - 1
WINDOW_US = 120_000_000
BURST_US = 500_000
DRIFT_MAX_PPM = 20_000.0
PRIOR_S = 0.25
RULED_OUT = 100.0
BEYOND_US = 1.0
NOISE_MIN_US = 3.0
LATE_MAX_US = 10e6
ROUNDS_MAX = 8
SAME_PPM = 0.01


def signed(value):
    value &= MASK
    return value - (1 << 64) if value >> 63 else value


def unzigzag(value):
    return value >> 1 ^ -(value & 1)


@dataclass
class Clock:
    segment: int
    tick_hz: int
    probes: list  # (ticks, sent_us, round_trip_us)
    points: list  # (ticks, host_us)
    line: tuple | None  # (ticks, host_ns, drift_ppb, (bound in us, bound in ppb) or None)
    jitter: dict


def times(data, origin, tick_hz, more):
    cursor, (ticks, us) = Cursor(data), origin
    while cursor.left():
        passed_us = cursor.varint()
        expected = signed(passed_us) * tick_hz // 1_000_000
        ticks = (ticks + expected + unzigzag(cursor.varint())) & MASK
        us = (us + passed_us) & MASK
        yield (ticks, us, cursor.varint()) if more else (ticks, us)


def read_clock(payload):
    r = Record(payload, 1)
    segment, tick_hz = r.unsigned(), r.unsigned()
    origin = r.unsigned(), r.unsigned()
    probes = list(times(r.take(r.unsigned()), origin, tick_hz, True))
    points = list(times(r.take(r.unsigned()), origin, tick_hz, False))
    line = r.optional(lambda: (r.signed(), r.signed(), r.signed(), r.optional(lambda: (r.unsigned(), r.unsigned()))))
    names = ["frames", "residual_us", "p50_us", "p99_us", "max_us"]
    jitter = {name: r.unsigned() for name in names}
    r.finish()
    if line:
        at = points[-1] if points else origin
        line = ((at[0] + line[0]) & MASK, (at[1] * 1000 + line[1]) & MASK, *line[2:])
    return Clock(segment, tick_hz, probes, points, line, jitter)


def peak(height):
    """The position of the maximum of a concave function."""
    low, high = -DRIFT_MAX_PPM, DRIFT_MAX_PPM
    for _ in range(80):
        third = (high - low) / 3
        if height(low + third) < height(high - third):
            low += third
        else:
            high -= third
    return (low + high) / 2


class Bounds:
    """Observations on one side of the line, as seconds and microseconds relative to the nominal rate."""

    def __init__(self, points, at, tick_hz):
        self.xy = []
        for ticks, us in points:
            x = signed(ticks - at[0]) / tick_hz
            self.xy.append((x, signed(us - at[1]) - x * 1e6))

    def over(self, ppm):
        return [y - ppm * x for x, y in self.xy]

    def least(self, ppm):
        return min(self.over(ppm), default=float("inf"))

    def most(self, ppm):
        return max(self.over(ppm), default=float("-inf"))

    def mean(self, ppm):
        return sum(self.over(ppm)) / len(self.xy)


def bursts_of(probes, tick_hz, drift_ppm):
    """For each burst its first time, latest ping and earliest pong, and the difference of the second best to each."""
    groups = []
    for ticks, sent_us, trip_us in probes:
        if not groups or abs(sent_us - groups[-1][0][1]) >= BURST_US:
            groups.append([])
        groups[-1].append((ticks, sent_us, sent_us + trip_us))
    bursts = []
    for group in groups:
        seen = [(us - signed(t - group[0][0]) / tick_hz * (1e6 + drift_ppm), t, us) for t, us, _ in group]
        heard = [(us - signed(t - group[0][0]) / tick_hz * (1e6 + drift_ppm), t, us) for t, _, us in group]
        seen.sort(reverse=True)
        heard.sort()
        if len(group) > 1:
            next_us = seen[0][0] - seen[1][0], heard[1][0] - heard[0][0]
        else:
            next_us = (group[0][2] - group[0][1],) * 2
        bursts.append((group[0][1], seen[0][1:], heard[0][1:], next_us))
    return bursts


def lay(points, bursts, tick_hz):
    """Place (ticks, host us), delay of the line there in us, drift in ppm. None if it violates a bound."""
    at = points[-1] if points else bursts[-1][1]
    arrivals = Bounds(points, at, tick_hz)
    low = Bounds([burst[1] for burst in bursts], at, tick_hz)
    high = Bounds([burst[2] for burst in bursts], at, tick_hz)
    tell = len(bursts) >= 3 and bursts[-1][0] - bursts[0][0] >= 1_000_000
    noise = [sum(b[3][i] for b in bursts) / max(len(bursts), 1) + NOISE_MIN_US for i in (0, 1)]

    def gap(ppm):
        return min(arrivals.least(ppm), high.least(ppm)) - low.most(ppm)

    def merit(ppm):
        ruled_out = RULED_OUT * min(gap(ppm), 0) if bursts else 0
        if tell:
            slack = (low.most(ppm) - low.mean(ppm)) / noise[0] + (high.mean(ppm) - high.least(ppm)) / noise[1]
            return ruled_out - PRIOR_S * abs(ppm) / sum(noise) - slack
        return arrivals.least(ppm) - arrivals.mean(ppm) + ruled_out - PRIOR_S * abs(ppm)

    ppm = peak(merit) if tell or points else 0.0
    if not bursts:
        return at, arrivals.least(ppm), ppm
    if gap(ppm) < -BEYOND_US or (points and arrivals.least(ppm) - high.least(ppm) > LATE_MAX_US):
        return None
    return at, low.most(ppm) + max(gap(ppm), 0) / 2, ppm


def lines_of(clocks):
    """The line of the last segment, fitted to all of its observations in the take: to the best round trips at the
    stored rate, then at the line's own, until both agree. Usually there is one; the stored line is one of them."""
    last = [clock for clock in clocks if clock.segment == clocks[-1].segment]
    tick_hz = last[0].tick_hz
    points = [point for clock in last for point in clock.points]
    probes = [probe for clock in last for probe in clock.probes]
    newest = points[-1][1] if points else 0
    points = [point for point in points if point[1] + WINDOW_US >= newest]
    drift_ppm = last[-1].line[2] / 1e3 if last[-1].line else 0.0
    chosen, before_ppm = None, None
    for _ in range(ROUNDS_MAX):
        bursts = bursts_of(probes, tick_hz, drift_ppm)
        bursts = [burst for burst in bursts if burst[0] + WINDOW_US >= bursts[-1][0]]
        chosen_before, chosen = chosen, [burst[1:3] for burst in bursts]
        if chosen == chosen_before and abs(drift_ppm - before_ppm) < SAME_PPM:
            return
        line = newest_line(points, bursts, tick_hz)
        yield line
        before_ppm, drift_ppm = drift_ppm, line[2]


def newest_line(points, bursts, tick_hz):
    """Drops the oldest bursts, and all points before them, until a line keeps all bounds."""
    while bursts:
        line = lay(points, bursts, tick_hz)
        if line:
            return line
        bursts = bursts[1:]
        if bursts:
            points = [point for point in points[:-1] if point[1] >= bursts[0][0]] + points[-1:]
    return lay(points, [], tick_hz)
