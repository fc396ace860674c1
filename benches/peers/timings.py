"""Speed of the peers: one process, one thread, in the smallest layout, quantisation and packing included.

MB/s count 12 bytes for each sample present, like the figures of mocapd. The transposition of arrays for SZ3 and SPERR
is not timed.
"""

import statistics
import time

from families.registry import all_codecs

# A short take is encoded repeatedly, so that a measurement is long compared with clock resolution and scheduling.
SECONDS_MIN = 0.02
REPEATS = 3


def seconds(work):
    """Median of 3 measurements, each the mean of enough calls to last SECONDS_MIN."""
    start = time.perf_counter()
    work()
    calls = max(1, round(SECONDS_MIN / max(time.perf_counter() - start, 1e-6)))
    measured = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        for _ in range(calls):
            work()
        measured.append((time.perf_counter() - start) / calls)
    return statistics.median(measured)


def fastest(rounds, names):
    """For each row, the highest speeds over the rounds: other load of the machine can only slow a measurement down."""
    best = {}
    for row in [row for rows in rounds for row in rows]:
        kept = best.setdefault(tuple(row[name] for name in names), row)
        for key in ("encode_mb_s", "decode_mb_s"):
            kept[key] = max(kept[key], row[key])
    return list(best.values())


def speed_rows(take, rows):
    """Encode and decode MB/s of each timed codec at each tolerance of one take; `rows` come from sizes.rows_of."""
    timed = {codec.name: codec for codec in all_codecs() if codec.timed}
    out = []
    for row in rows:
        if row["take"] != take.name or row["codec"] not in timed:
            continue
        filled = next(fill for fill in take.fills if fill.gaps == row["gaps"])
        way = timed[row["codec"]].way_named(filled, row["layout"])
        axis = row["axis_tolerance_mm"]
        payload = way.encode(filled, axis)
        megabytes = take.raw_bytes / 1e6
        out.append(
            {
                "take": take.name,
                "raw_bytes": take.raw_bytes,
                "filtered": take.filtered,
                "tolerance_mm": row["tolerance_mm"],
                "codec": row["codec"],
                "encode_mb_s": megabytes / seconds(lambda: way.encode(filled, axis)),
                "decode_mb_s": megabytes / seconds(lambda: way.decode(filled, payload)),
            }
        )
    return out
