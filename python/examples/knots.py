"""A marker's way, the samples that its take keeps, and how far they lie apart in time.

    python knots.py TAKE [MARKER] [-o FILE.png]

Written in cells (`# %%`), so that editors run it piece by piece.
"""

# %% The take, and a marker of it
import argparse

import matplotlib

import mocapd

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("take")
parser.add_argument("marker", nargs="?", help="a label; the one that moves most unless given")
parser.add_argument("-o", "--output", help="a picture; unless given, a window")
arguments = parser.parse_args()
if arguments.output:
    matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

take = mocapd.open(arguments.take)
print(take)

# %% Which one moves most: the spread of its positions, gaps aside
spread_mm = np.nan_to_num(np.nanstd(take.positions, axis=0)).sum(axis=1)
label = arguments.marker or take.labels[int(spread_mm.argmax())]
marker = take[label]
print(f"{label}: {take.summary[label].n_samples} samples, {marker.n_knots} of them kept, "
      f"within {marker.max_error_mm:.3f} mm")

# %% Its way in time, and the samples that are kept
time_s = take.times().nominal_s
figure, (ways, below) = plt.subplots(
    2, 1, figsize=(10, 6), sharex=True, height_ratios=[3, 1], layout="constrained"
)
for axis, colour in zip(range(3), ["#b3372f", "#2f7d4f", "#2f5d9b"]):
    ways.plot(time_s, marker.positions[:, axis], color=colour, linewidth=1, label="xyz"[axis])
    ways.plot(marker.knot_times_s, marker.positions[marker.knots, axis], ".", color=colour, markersize=4)
ways.set_ylabel("mm")
ways.set_title(f"{label}: {marker.n_knots} of {take.summary[label].n_samples} samples are kept, "
               f"tolerance {take.header.tolerance_mm:g} mm")
ways.legend(loc="upper left", ncols=3, frameon=False)

# %% Where it moves quickly, they lie close together
below.step(marker.knot_times_s[:-1], np.diff(marker.knot_times_s) * 1000, where="post", color="#444444")
below.set_ylabel("to the next, ms")
below.set_xlabel("s")
for lost in take.lost:
    for axes in (ways, below):
        axes.axvspan(lost.first_frame / take.rate_hz, (lost.first_frame + lost.n_frames) / take.rate_hz, alpha=0.2)

if arguments.output:
    figure.savefig(arguments.output, dpi=110)
else:
    plt.show()
