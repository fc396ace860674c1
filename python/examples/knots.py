"""Plots a marker's trajectory, its kept samples (knots), and the time between them.

    python knots.py TAKE [MARKER] [-o FILE.png]

Divided into cells (`# %%`), which editors can run one by one.
"""

# %% Open the take
import argparse

import matplotlib

import mocapd

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("take")
parser.add_argument("marker", nargs="?", help="label of the marker; by default the one that moves most")
parser.add_argument("-o", "--output", help="image file; by default the plot opens in a window")
arguments = parser.parse_args()
if arguments.output:
    matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

take = mocapd.open(arguments.take)
print(take)

# %% Choose a marker: the one that moves most has the largest standard deviation of positions
spread_mm = np.nan_to_num(np.nanstd(take.positions, axis=0)).sum(axis=1)
label = arguments.marker or take.labels[int(spread_mm.argmax())]
marker = take[label]
print(f"{label}: {take.summary[label].n_samples} samples, {marker.n_knots} kept, "
      f"within {marker.max_error_mm:.3f} mm")

# %% Plot its coordinates over time, and the kept samples
time_s = take.times().nominal_s
figure, (trajectory, intervals) = plt.subplots(
    2, 1, figsize=(10, 6), sharex=True, height_ratios=[3, 1], layout="constrained"
)
for axis, colour in zip(range(3), ["#b3372f", "#2f7d4f", "#2f5d9b"]):
    trajectory.plot(time_s, marker.positions[:, axis], color=colour, linewidth=1, label="xyz"[axis])
    trajectory.plot(marker.knot_times_s, marker.positions[marker.knots, axis], ".", color=colour, markersize=4)
trajectory.set_ylabel("mm")
trajectory.set_title(f"{label}: {marker.n_knots} of {take.summary[label].n_samples} samples kept, "
                     f"tolerance {take.header.tolerance_mm:g} mm")
trajectory.legend(loc="upper left", ncols=3, frameon=False)

# %% Plot the time between kept samples: they are close together where the marker moves quickly
intervals.step(marker.knot_times_s[:-1], np.diff(marker.knot_times_s) * 1000, where="post", color="#444444")
intervals.set_ylabel("time to next, ms")
intervals.set_xlabel("s")
for lost in take.lost:
    for axes in (trajectory, intervals):
        axes.axvspan(lost.first_frame / take.rate_hz, (lost.first_frame + lost.n_frames) / take.rate_hz, alpha=0.2)

if arguments.output:
    figure.savefig(arguments.output, dpi=110)
else:
    plt.show()
