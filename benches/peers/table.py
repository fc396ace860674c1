"""Markdown tables for docs/benchmarks.md."""

import statistics

from bars import DENSE, SPEED_RAW_BYTES_MIN, best_peers, cell, of

SPEED_TEXT = (
    "Speed, MB/s of 12 bytes a sample present, one thread, median over the takes of "
    f"{SPEED_RAW_BYTES_MIN // 1000} kB and more that are not filtered. "
    "Peers are timed in the layout and setting that made them smallest. In the q+delta rows quantising, differences "
    "and packing are numpy: a compiled program would be faster."
)


def markdown(header, rows):
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def tolerances_of(rows):
    return sorted({row["tolerance_mm"] for row in rows})


def median_ratios(rows, key, tolerances):
    """Name -> {tolerance: median ratio over the takes that are not filtered}; every take has the same weight."""
    ratios = {}
    for row in rows:
        if not row["filtered"] and row["tolerance_mm"] in tolerances:
            found = ratios.setdefault(row[key], {}).setdefault(row["tolerance_mm"], [])
            found.append(row["raw_bytes"] / row["bytes"])
    return {name: {t: statistics.median(v) for t, v in by.items()} for name, by in ratios.items()}


def by_ratio(ratios):
    """Names, in descending order of the ratio at 1 mm."""
    return sorted(ratios, key=lambda name: -ratios[name].get(1.0, 0.0))


def ratio_table(peers, ours):
    tolerances = tolerances_of(peers)
    own = {f"**mocapd {name}**": v for name, v in median_ratios(ours, "resampler", tolerances).items()}
    ratios = own | median_ratios(peers, "codec", tolerances)
    rows = [
        [name] + [f"{ratios[name][t]:.1f}" if t in ratios[name] else "" for t in tolerances]
        for name in by_ratio(ratios)
    ]
    return markdown(["codec"] + [f"{t:g} mm" for t in tolerances], rows)


def cell_table(peers, ours):
    """For each take and tolerance: bytes and name of the best peer, bytes of mocapd, their quotient."""
    tolerances = tolerances_of(peers)
    best, dense = best_peers(peers), of(ours, "resampler", DENSE)
    takes = {row["take"]: row for row in peers}
    rows = []
    for name in sorted(takes, key=lambda n: (takes[n]["filtered"], n)):
        cells = []
        for tolerance in tolerances:
            peer = best.get((name, tolerance))
            if not peer:
                cells.append("")
                continue
            text = f"{peer['bytes']} {peer['codec']}"
            if cell(peer) in dense:
                own = dense[cell(peer)]["bytes"]
                text += f" / {own} (**{peer['bytes'] / own:.2f}**)"
            cells.append(text)
        note = " (filtered)" if takes[name]["filtered"] else ""
        rows.append([name + note, str(takes[name]["raw_bytes"])] + cells)
    return markdown(["take", "raw bytes"] + [f"{t:g} mm" for t in tolerances], rows)


def median_speeds(rows, key, tolerances):
    speeds = {}
    for row in rows:
        if not row["filtered"] and row["raw_bytes"] >= SPEED_RAW_BYTES_MIN and row["tolerance_mm"] in tolerances:
            found = speeds.setdefault(row[key], {}).setdefault(row["tolerance_mm"], [])
            found.append((row["encode_mb_s"], row["decode_mb_s"]))
    return {n: {t: [statistics.median(s) for s in zip(*v)] for t, v in by.items()} for n, by in speeds.items()}


def speed_table(speeds, ours):
    tolerances = tolerances_of(speeds)
    own = {f"**mocapd {name}**": v for name, v in median_speeds(ours, "resampler", tolerances).items()}
    both = own | median_speeds(speeds, "codec", tolerances)
    rows = []
    for name, by in both.items():
        rows.append([name] + ["{:.0f} / {:.0f}".format(*by[t]) if t in by else "" for t in tolerances])
    return markdown(["encode / decode MB/s"] + [f"{t:g} mm" for t in tolerances], rows)


def everything(peers, ours, speeds, versions):
    takes = {row["take"]: row["filtered"] for row in peers}
    headline = sum(not filtered for filtered in takes.values())
    parts = [
        f"Ratio (12 bytes a sample present, over bytes), median over the {headline} takes that are not filtered:",
        ratio_table(peers, ours),
        "Each take: bytes of the best peer" + (" / of mocapd dense (factor):" if ours else ":"),
        cell_table(peers, ours),
    ]
    if speeds:
        parts += [SPEED_TEXT, speed_table(speeds, ours)]
    parts.append("Versions: " + ", ".join(versions) + ".")
    return "\n\n".join(parts) + "\n"
