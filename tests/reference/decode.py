"""Decodes a take in plain Python, slowly, in the steps of docs/take-format.md and docs/codec.md.

    python tests/reference/decode.py TAKE [--raw OUT]

`--raw` writes the rows one after another, each with all its channels, each channel as one byte (bit 0: there is a
sample; bit 1: it was kept) and three little-endian float32 in millimetres (zeros where there is none).
"""

import argparse
import struct
import sys
import time
from pathlib import Path

from take.errors import Corrupt
from take.stretch import read_take

NONE = bytes(13)


def write_raw(take, path):
    n_channels = max([len(take.channels), *(channel + 1 for channel in take.tracks)])
    with open(path, "wb") as out:
        for row in range(take.n_rows):
            for channel in range(n_channels):
                sample = take.tracks.get(channel, {}).get(row)
                if sample is None:
                    out.write(NONE)
                else:
                    position, kept = sample
                    out.write(struct.pack("<B3f", 1 | kept << 1, *position))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("take", type=Path)
    parser.add_argument("--raw", type=Path, help="write positions and flags")
    args = parser.parse_args()
    start = time.perf_counter()
    try:
        take = read_take(args.take.read_bytes())
    except Corrupt as error:
        sys.exit(f"{args.take}: {error}")
    seconds = time.perf_counter() - start
    samples = sum(map(len, take.tracks.values()))
    kept = sum(kept for track in take.tracks.values() for _, kept in track.values())
    print(f"{take.header.resampler}, {take.header.tolerance_mm} mm, {take.header.rate_hz} Hz")
    print(f"{take.n_rows} rows, {len(take.channels)} channels, {samples} samples, {kept} kept")
    print(f"{len(take.times)} rows with a time; " + ("finished" if take.finished else "cut off"))
    if take.ending:
        name, detail = take.ending
        print(f"it ended: {name}" + (f", {detail}" if detail else ""))
    print(f"{seconds:.2f} s, {seconds / max(samples, 1) * 1e6:.0f} us a sample")
    if args.raw:
        write_raw(take, args.raw)


if __name__ == "__main__":
    main()
