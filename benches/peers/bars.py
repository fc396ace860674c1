"""The claims of the documentation about mocapd's codec, evaluated on the rows of one run."""

import math
from dataclasses import asdict, dataclass

DENSE, FAST, SPLINE = "dense", "fast", "spline:worst-sample"

# Shorter takes measure the overhead of a call, not the codec: the speed claims leave them out.
SPEED_RAW_BYTES_MIN = 300_000

# How many times as many bytes the best peer needs: of the live encoder, and of the highest effort.
AGAINST_BEST_PEER = 1.9, 2.11


@dataclass
class Bar:
    """One claim: the measured value, its limit (a minimum, or a maximum without `at_least`), and the worst cell."""

    name: str
    value: float
    target: float
    at_least: bool
    worst: str

    @property
    def held(self):
        return self.value >= self.target if self.at_least else self.value < self.target


def geometric_mean(values):
    values = list(values)
    return math.exp(sum(map(math.log, values)) / len(values)) if values else float("nan")


def cell(row):
    return row["take"], row["tolerance_mm"]


def best_peers(rows, key="bytes"):
    """The smallest peer of any codec for each (take, tolerance).

    In `bytes`, the axis tolerance of error-bounded peers was raised for each take until the measured error reached the
    bound; in `plain_bytes` it is the bound over sqrt(3), which guarantees the bound for any data.
    """
    best = {}
    for row in rows:
        if cell(row) not in best or row[key] < best[cell(row)][key]:
            best[cell(row)] = row
    return best


def of(rows, key, name):
    return {cell(row): row for row in rows if row[key] == name}


def factors(ours, theirs, key="bytes"):
    """Bytes of the peer over those of mocapd, for each cell that both have."""
    return {at: theirs[at][key] / row["bytes"] for at, row in ours.items() if at in theirs}


def headline(values, ours):
    """The values of the takes that are not filtered."""
    return {at: value for at, value in values.items() if not ours[at]["filtered"]}


def named(at):
    return f"{at[0]} at {at[1]:g} mm"


def worst_of(values, worst=min):
    at = worst(values, key=values.get, default=None)
    return f"{values[at]:.2f} ({named(at)})" if at else "nothing to compare"


def size_bars(ours, peers, effort, tuned):
    dense, fast, spline = (of(ours, "resampler", name) for name in (DENSE, FAST, SPLINE))
    against_best = headline(factors(dense, best_peers(peers)), dense)
    plain_peers = best_peers(peers, "plain_bytes")
    against_plain = headline(factors(dense, plain_peers, "plain_bytes"), dense)
    against_spline = headline(factors(dense, spline), dense)
    against_zstd = headline(factors(fast, of(peers, "codec", "q+delta+zstd-3")), fast)
    of_zstd = {at: 1 / factor for at, factor in against_zstd.items()}
    smallest = min(against_best.values(), default=float("nan"))
    guaranteed = [
        Bar(
            f"dense of effort {effort} against the best peer of each cell at bound/sqrt(3) an axis, geometric mean",
            geometric_mean(against_plain.values()),
            AGAINST_BEST_PEER[effort >= 9],
            True,
            worst_of(against_plain),
        ),
    ]
    raised = [
        Bar(
            "dense against the best peer of each cell, its tolerance tuned to the take, geometric mean",
            geometric_mean(against_best.values()),
            1.75,
            True,
            worst_of(against_best),
        ),
        Bar("dense against the best tuned peer of each cell, worst cell", smallest, 1.0, True, worst_of(against_best)),
    ]
    others = [
        Bar(
            "dense against the spline, geometric mean",
            geometric_mean(against_spline.values()),
            8.0,
            True,
            worst_of(against_spline),
        ),
        Bar(
            "bytes of fast over those of q+delta+zstd-3, geometric mean",
            geometric_mean(of_zstd.values()),
            1.0,
            False,
            worst_of(of_zstd, max),
        ),
    ]
    return guaranteed + (raised if tuned else []) + others


def speed_ratio(fast, sz3, key):
    """The geometric mean over the takes at the tolerance where it is smallest, and that tolerance."""
    by_tolerance = {}
    for at, row in fast.items():
        if at in sz3 and not row["filtered"] and row["raw_bytes"] >= SPEED_RAW_BYTES_MIN:
            by_tolerance.setdefault(at[1], []).append(row[key] / sz3[at][key])
    means = {tolerance: geometric_mean(values) for tolerance, values in by_tolerance.items()}
    worst = min(means, key=means.get, default=None)
    return (means[worst], f"at {worst:g} mm") if worst else (float("nan"), "nothing to compare")


def median_speed(rows, tolerance_mm, key):
    values = sorted(
        row[key]
        for row in rows.values()
        if row["tolerance_mm"] == tolerance_mm and not row["filtered"] and row["raw_bytes"] >= SPEED_RAW_BYTES_MIN
    )
    if not values:
        return float("nan"), "nothing to compare"
    middle = len(values) // 2
    median = values[middle] if len(values) % 2 else (values[middle - 1] + values[middle]) / 2
    return median, f"slowest take {values[0]:.0f} MB/s"


def speed_bars(ours, speeds):
    dense, fast = of(ours, "resampler", DENSE), of(ours, "resampler", FAST)
    sz3 = of(speeds, "codec", "SZ3")
    bars = []
    for word, key, target in (("encode", "encode_mb_s", 50.0), ("decode", "decode_mb_s", 70.0)):
        value, worst = speed_ratio(fast, sz3, key)
        bars.append(Bar(f"{word} speed of fast over SZ3's, lowest of the tolerances", value, 1.0, True, worst))
        value, worst = median_speed(dense, 1.0, key)
        bars.append(Bar(f"dense {word} MB/s at 1 mm, median take", value, target, True, worst))
    return bars


def all_bars(ours, peers, speeds, names=None, effort=1, tuned=True):
    """All claims; with a selection of peers (`names`) or peers that are not tuned, only those for which these suffice."""
    bars = [] if names else size_bars(ours, peers, effort, tuned)
    return bars + (speed_bars(ours, speeds) if speeds and "SZ3" in (names or ["SZ3"]) else [])


def as_json(bars):
    return [{**asdict(bar), "held": bar.held} for bar in bars]


def as_text(bars):
    lines = []
    for bar in bars:
        sign = ">=" if bar.at_least else "<"
        result = "held" if bar.held else "FAILED"
        lines.append(f"{result:7} {bar.name}: {bar.value:.3g} (must be {sign} {bar.target:g}); worst {bar.worst}")
    return "\n".join(lines)
