"""What reading costs, on takes of one's own: the best of some runs.

    python bars.py TAKE... [--marker LABEL] [--runs 5]

Opening, a minute of one marker, of the next one, and all of it; beside each the codec's rate in MB of float32 a second.
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
    parser.add_argument("--marker", help="a label; the first marker unless given")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--threads", type=int)
    arguments = parser.parse_args()
    for path in arguments.takes:
        take = mocapd.open(path, threads=arguments.threads)
        print(take)
        opening = best(arguments.runs, lambda: mocapd.open(path))
        middle = take.duration_s / 2
        column = take.labels.index(arguments.marker) if arguments.marker else 0
        # Opened each time: what was decoded last is kept.
        again = lambda: mocapd.open(path, threads=arguments.threads)  # noqa: E731
        minute = best(arguments.runs, lambda: again().read(middle, middle + 60, column))
        take.read(middle, middle + 60, column)
        others = best(arguments.runs, lambda: take.read(middle, middle + 60, (column + 1) % take.n_markers))
        whole = best(max(1, arguments.runs // 2), take.read)
        mb = take.n_frames * take.n_markers * 12 / 1e6
        print(f"  open {opening * 1e3:.1f} ms, a minute of one marker {minute * 1e3:.1f} ms, opening included")
        print(f"  the same minute of the next marker {others * 1e3:.2f} ms")
        print(f"  all of it {whole:.2f} s, {mb / whole:.0f} MB/s")


if __name__ == "__main__":
    main()
