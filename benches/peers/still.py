"""Compares mocapd's imports of a nearly still take with the best peer at every tolerance.

    pip install -r benches/peers/requirements.txt
    python benches/peers/still.py [--mocapd PATH] [--effort N] [--check]

The take is generated: 7 markers sway by 4 mm for 240 s at 100 Hz, with noise and gaps. Peers are those of `run.py`, at
the bound over sqrt(3) on each axis and with the tolerance tuned to the take; the smaller one counts. Of mocapd, blocks
and timeline are compared, since no peer has a header, labels or checksums; the whole file is printed beside them.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import ours as ours_  # noqa: E402
import sizes  # noqa: E402
from families.registry import all_codecs  # noqa: E402

RATE_HZ, SECONDS, MARKERS = 100, 240, 7

# By the distance of keys, claims that --check tests: bytes of mocapd over those of the best peer, the largest of all
# tolerances. By default, stretches of ten seconds in which nothing moves are joined. No peer has keys, so `--keys 10s` is
# shown without a claim: at 20 mm a position takes 17 bits (a ball of 20 mm in a cube of 1.8 m), so those of seven markers
# in 24 key stretches alone are more bytes than all of the best peer.
BARS = {"default": 0.8, "10s": None, "none": 0.7}


def still_take(seed=25):
    """Positions in millimetres (frames, markers, 3): a person who stands; NaN in gaps."""
    rng = np.random.default_rng(seed)
    t = np.arange(RATE_HZ * SECONDS) / RATE_HZ
    places = rng.uniform(-900, 900, (MARKERS, 3))
    # Sway is slow: three sines below 0.6 Hz, of 2 mm to each side together, larger for markers higher up.
    sway = np.zeros((len(t), 3))
    for share in (0.5, 0.3, 0.2):
        frequency_hz, phase = rng.uniform(0.05, 0.6, 3), rng.uniform(0, 2 * np.pi, 3)
        sway += 2.0 * share * np.sin(2 * np.pi * frequency_hz * t[:, None] + phase)
    positions = places + sway[:, None, :] * rng.uniform(0.6, 1.0, (MARKERS, 1))
    positions += np.clip(rng.normal(0, 0.02, positions.shape), -0.05, 0.05)
    for _ in range(20):
        start, length = rng.integers(0, len(t)), rng.integers(5, 300)
        positions[start : start + length, rng.integers(0, MARKERS)] = np.nan
    return positions.astype(np.float32)


def write_csv(path, positions):
    """In the layout that `mocapd import` reads, with the digits that restore float32."""
    names = [f"M{marker}.{axis}" for marker in range(MARKERS) for axis in "xyz"]
    lines = [f"# rate={RATE_HZ}", ",".join(["time_s", *names])]
    for index, row in enumerate(positions.reshape(len(positions), -1)):
        cells = ["" if np.isnan(value) else f"{value:.9g}" for value in row]
        lines.append(",".join([f"{index / RATE_HZ:.2f}", *cells]))
    path.write_text("\n".join(lines) + "\n")


def take_bytes(program, source, tolerance_mm, keys, effort):
    """Bytes of blocks and timeline, and of the whole file."""
    output = source.with_suffix(".take")
    output.unlink(missing_ok=True)
    options = ["--tolerance", f"{tolerance_mm:g}mm", "--effort", str(effort), "-o", str(output)]
    if keys != "default":
        options += ["--keys", keys]
    subprocess.run([str(program), "import", str(source), *options], check=True, capture_output=True)
    shown = subprocess.run([str(program), "info", "--json", str(output)], check=True, capture_output=True)
    of = json.loads(shown.stdout)["bytes"]
    return of["blocks"] + of["time_line"], output.stat().st_size


def best_peers(source):
    """The name and bytes of the smallest peer by tolerance."""
    best = {}
    names = [codec.name for codec in all_codecs()]
    with ProcessPoolExecutor(2) as pool:
        jobs = [pool.submit(sizes.rows_of, source, None, name, sizes.TOLERANCES_MM) for name in names]
        rows = [row for job in jobs for row in job.result()]
    for row in rows:
        found = min(row["bytes"], row["plain_bytes"]), row["codec"]
        at = row["tolerance_mm"]
        best[at] = min(best.get(at, found), found)
    return best


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mocapd", metavar="PATH", help="default: target/release/mocapd")
    parser.add_argument("--effort", type=int, default=3)
    parser.add_argument("--check", action="store_true", help="exit code 1 when a claim does not hold")
    options = parser.parse_args()
    program = ours_.find(options.mocapd)
    worst = dict.fromkeys(BARS, 0.0)
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "still.csv"
        write_csv(source, still_take())
        best = best_peers(source)
        print("| mm | best peer | bytes | default | `--keys 10s` | `--keys none` |\n|---|---|---|---|---|---|")
        for tolerance_mm, (peer_bytes, name) in sorted(best.items()):
            cells = [f"{tolerance_mm:g}", name, str(peer_bytes)]
            for keys in BARS:
                ours, file_bytes = take_bytes(program, source, tolerance_mm, keys, options.effort)
                worst[keys] = max(worst[keys], ours / peer_bytes)
                cells.append(f"{ours} ({ours / peer_bytes:.2f}), file {file_bytes}")
            print("| " + " | ".join(cells) + " |")
    held = True
    for keys, limit in BARS.items():
        if limit is None:
            print(f"        keys {keys}: {worst[keys]:.2f} times the best peer")
            continue
        held &= worst[keys] <= limit
        result = "held" if worst[keys] <= limit else "FAILED"
        print(f"{result:7} keys {keys}: {worst[keys]:.2f} times the best peer (must be <= {limit:g})")
    return 1 if options.check and not held else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (FileNotFoundError, RuntimeError, subprocess.CalledProcessError) as problem:
        print(problem, file=sys.stderr)
        sys.exit(2)
