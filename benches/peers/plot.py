"""Compression ratio against tolerance, both axes logarithmic: bold lines for mocapd, thin ones for its peers, each
labelled at its end."""

import math

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

from table import median_ratios, tolerances_of  # noqa: E402

# The colours of Okabe and Ito, distinguishable with colour blindness; peers differ in grey level and dash pattern.
OWN = {"dense": "#0072B2", "fast": "#009E73", "spline": "#D55E00", "sync": "#E69F00", "lossless": "#CC79A7"}
OTHER_OWN = "#56B4E9"
PEERS = ["#000000", "#7a7a7a"]
DASHES = ["-", "--", ":", "-."]

# Smallest vertical distance between two labels, as a fraction of the logarithmic axis.
NAME_GAP = 0.034


def spread(places, gap):
    """Moves labels apart without changing their order: neighbours are at least `gap` apart."""
    order = sorted(range(len(places)), key=places.__getitem__)
    groups = []
    for index in order:
        groups.append([places[index], 1])
        while len(groups) > 1 and groups[-1][0] - groups[-2][0] < gap * (groups[-1][1] + groups[-2][1]) / 2:
            centre, count = groups.pop()
            before = groups[-1]
            before[0] = (before[0] * before[1] + centre * count) / (before[1] + count)
            before[1] += count
    moved = [centre + gap * (i - (count - 1) / 2) for centre, count in groups for i in range(count)]
    return {index: place for index, place in zip(order, moved)}


def draw(peers, ours, out):
    tolerances = tolerances_of(peers)
    lines = []
    for name, ratios in median_ratios(ours, "resampler", tolerances).items():
        style = {"color": OWN.get(name.split(":")[0], OTHER_OWN), "linewidth": 3.0, "zorder": 3}
        lines.append((f"mocapd {name.split(':')[0]}", ratios, style))
    for number, (name, ratios) in enumerate(median_ratios(peers, "codec", tolerances).items()):
        style = {"color": PEERS[number % 2], "linewidth": 1.0, "linestyle": DASHES[number // 2 % 4], "zorder": 2}
        lines.append((name, ratios, style))

    figure, axes = plt.subplots(figsize=(9.0, 7.0))
    for _, ratios, style in lines:
        at = sorted(ratios)
        axes.plot(at, [ratios[t] for t in at], **style)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(tolerances, [f"{t:g}" for t in tolerances])
    axes.minorticks_off()
    low, high = axes.get_ylim()
    ticks = [t for t in (0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000) if low <= t <= high]
    axes.set_yticks(ticks, [f"{t:g}" for t in ticks])
    axes.set_xlabel("largest 3-D error of any sample (mm)")
    axes.set_ylabel("ratio to float32 (median take)")
    axes.grid(True, linewidth=0.4, color="#dddddd")
    axes.spines[["top", "right"]].set_visible(False)
    name_ends(axes, lines)
    figure.tight_layout()
    for suffix in (".svg", ".png"):
        figure.savefig(
            out.with_suffix(suffix), dpi=150, bbox_inches="tight", metadata={"Date": None} if suffix == ".svg" else None
        )


def name_ends(axes, lines):
    low, high = (math.log10(v) for v in axes.get_ylim())
    ends = [(math.log10(ratios[max(ratios)]) - low) / (high - low) for _, ratios, _ in lines]
    for index, place in spread(ends, NAME_GAP).items():
        name, ratios, style = lines[index]
        axes.annotate(
            name,
            xy=(max(ratios), ratios[max(ratios)]),
            xytext=(1.06, place),
            textcoords="axes fraction",
            va="center",
            color=style["color"],
            fontweight="bold" if style["linewidth"] > 2 else "normal",
            fontsize=9,
            arrowprops={
                "arrowstyle": "-",
                "color": "#bbbbbb",
                "linewidth": 0.5,
                "shrinkA": 2,
                "shrinkB": 1,
                "relpos": (0, 0.5),
            },
        )
