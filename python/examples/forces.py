"""Plots the force plates of a take that was imported from a C3D file: forces over time, and the paths of the centres of
pressure.

    python forces.py TAKE [-o IMAGE]
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np

import mocapd

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("take")
parser.add_argument("-o", "--output", help="image file; by default the plot is shown in a window")
arguments = parser.parse_args()

with mocapd.open(arguments.take) as take:
    if not take.force_plates:
        parser.exit(1, f"{arguments.take} has no force plates\n")
    figure, (over_time, from_above) = plt.subplots(1, 2, figsize=(12, 5), layout="constrained")
    for plate in take.force_plates:
        loads = plate.loads
        (line,) = over_time.plot(loads.time_s, np.linalg.norm(loads.force_n, axis=1), label=f"plate {plate.number}")
        # Corners in the first two axes of the laboratory that the plate spans.
        spans = np.ptp(plate.corners_mm, axis=0)
        x, y = sorted(np.argsort(spans)[1:])
        outline = np.vstack([plate.corners_mm, plate.corners_mm[:1]])
        from_above.plot(outline[:, x], outline[:, y], color=line.get_color(), linewidth=0.5)
        from_above.plot(loads.cop_mm[:, x], loads.cop_mm[:, y], color=line.get_color())
        peak_n = np.nanmax(np.linalg.norm(loads.force_n, axis=1))
        print(f"plate {plate.number}, type {plate.type}: at most {peak_n:.0f} N")
    for event in take.events:
        over_time.axvline(event.time_s, color="grey", linewidth=0.5)
        over_time.annotate(event.text, (event.time_s, 0.99), xycoords=("data", "axes fraction"), rotation=90, va="top")
    over_time.set(xlabel="time in s", ylabel="force in N")
    over_time.legend()
    from_above.set(xlabel=f"{'xyz'[x]} in mm", ylabel=f"{'xyz'[y]} in mm", aspect="equal")

if arguments.output:
    figure.savefig(arguments.output, dpi=110)
else:
    plt.show()
