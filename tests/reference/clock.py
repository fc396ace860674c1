"""Fits a take's clock line again, to its round trips and earliest frames, and compares it with the stored one.

    python tests/reference/clock.py TAKE [--sent LOG]

With the simulator's log (mocapd-sim serve --log), also prints the error of the stored line.
The exit code is 1 if the two lines differ by more than 20 us and a quarter of the bound, or the rates by more than
2 ppm and a quarter of theirs. They may differ because early recorders selected the best round trip of a burst with the
rate known at that time, whereas this script uses the final rate.
"""

import argparse
import csv
import sys
from pathlib import Path

from take.clock import KIND, lines_of, read_clock, signed
from take.container import chunks


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("take", type=Path)
    parser.add_argument("--sent", type=Path, help="the simulator's log")
    args = parser.parse_args()
    clocks = [read_clock(payload) for kind, payload in chunks(args.take.read_bytes()) if kind == KIND]
    if not clocks or not clocks[-1].line:
        sys.exit(f"{args.take}: it tells of no line")
    last = clocks[-1]
    ticks, host_ns, drift_ppb, bound = last.line

    def apart(line):
        at, late_us, ppm = line
        passed_s = signed(at[0] - ticks) / last.tick_hz
        stored_ns = host_ns + passed_s * (1e9 + drift_ppb)
        return at[1] + late_us - stored_ns / 1e3, ppm

    apart_us, ppm = min(map(apart, lines_of(clocks)), key=lambda found: abs(found[0]))
    n_probes = sum(len(clock.probes) for clock in clocks)
    n_points = sum(len(clock.points) for clock in clocks)
    print(f"{n_probes} round trips, {n_points} points, {last.segment + 1} segments")
    within = f"within {bound[0]} us and {bound[1] / 1e3} ppm" if bound else "without a bound"
    print(f"stored: {drift_ppb / 1e3:+.3f} ppm, {within}; laid again: {ppm:+.3f} ppm, {apart_us:+.1f} us apart")
    print(f"jitter: {last.jitter}")
    if args.sent:
        compare_with_truth(args.sent, last)
    bound_us, bound_ppb = bound or (0, 0)
    apart_ppm = ppm - drift_ppb / 1e3
    sys.exit(abs(apart_us) > 20 + bound_us / 4 or abs(apart_ppm) > 2 + bound_ppb / 4e3)


def compare_with_truth(path, clock):
    ticks, host_ns, drift_ppb, _ = clock.line
    off = []
    with open(path, newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            passed_s = (int(row["device_ticks"]) - ticks) / clock.tick_hz
            if abs(passed_s) < 5:
                off.append((host_ns - int(row["host_ns"]) + passed_s * (1e9 + drift_ppb)) / 1e3)
    if off:
        print(f"truth: the line is {min(off):+.1f} to {max(off):+.1f} us off within 5 s of where it is told")


if __name__ == "__main__":
    main()
