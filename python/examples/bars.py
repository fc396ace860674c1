"""Measures the speed of reading takes, as the best of several runs.

    python bars.py TAKE... [--marker LABEL] [--runs 5]

Times opening, a minute of one marker, the same minute of the next one, and the whole take, the last also in MB of
float32 a second.
"""

import argparse
import time

import mocapd


def best(runs, work):
    took = []
    for _ in range(runs):
        started = time.perf_counter()
        work()
        took.append(time.perf_counter() - started)
    return min(took)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("takes", nargs="+")
    parser.add_argument("--marker", help="label of the marker; by default the first one")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--threads", type=int)
    arguments = parser.parse_args()
    for path in arguments.takes:
        take = mocapd.open(path, threads=arguments.threads)
        print(take)
        opening = best(arguments.runs, lambda: mocapd.open(path))
        middle = take.duration_s / 2
        column = take.labels.index(arguments.marker) if arguments.marker else 0
        # Opened anew each time, because the decoded rows are cached.
        reopen = lambda: mocapd.open(path, threads=arguments.threads)  # noqa: E731
        minute = best(arguments.runs, lambda: reopen().read(middle, middle + 60, column))
        take.read(middle, middle + 60, column)
        next_marker = best(arguments.runs, lambda: take.read(middle, middle + 60, (column + 1) % take.n_markers))
        whole = best(max(1, arguments.runs // 2), take.read)
        mb = take.n_frames * take.n_markers * 12 / 1e6
        print(f"  open {opening * 1e3:.1f} ms, a minute of one marker {minute * 1e3:.1f} ms including opening")
        print(f"  the same minute of the next marker {next_marker * 1e3:.2f} ms")
        print(f"  whole take {whole:.2f} s, {mb / whole:.0f} MB/s")


if __name__ == "__main__":
    main()
