"""Compares the sampled channels of takes with published lossless codecs on the analog samples of C3D files.

    pip install -r benches/peers/requirements.txt
    apt-get install flac wavpack
    python benches/peers/analog.py FOLDER_OF_C3D_FILES [--mocapd PATH] [--check]

Each peer gets its best conditions: for every file the smallest of its layouts, and headers of audio files do not count.
A peer marked `+ lattice` gets, in place of the float32 samples of a channel, the integers of the lattice that they lie
on where that is smaller; the lattice itself, and what would restore the last bit of each sample, are free.
mocapd's bytes are those of the analog groups in a default take, with names, units and framing.
"""

import argparse
import json
import lzma
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import brotli
import ezc3d
import numpy as np
import soundfile
import zstandard
from pcodec import ChunkConfig, standalone

sys.path.insert(0, str(Path(__file__).resolve().parent))

import ours as ours_  # noqa: E402

# Claims that --check tests: bytes of the best peer over those of mocapd, as geometric means.
BARS = {"best peer": 1.25, "best peer + lattice": 1.12}

# Fewer distinct values than this are on a lattice by chance.
LATTICE_VALUES_MIN = 8

# Levels of FLAC and WavPack: their strongest.
FLAC = "flac --totally-silent --best --exhaustive-model-search --no-padding --no-seektable --channel-map=none".split()
WAVPACK = "wavpack -q -hh -x6 -y".split()


def lattice(samples):
    """The integers k with float32(k * quantum + offset) next to each sample, or None if there is no such lattice."""
    finite = samples[np.isfinite(samples)].astype(np.float64)
    values = np.unique(finite)
    if len(finite) < len(samples) or len(values) < LATTICE_VALUES_MIN:
        return None
    steps = np.diff(values)
    spacing = float(np.spacing(np.float32(np.abs(values).max())))
    # The quantum divides all steps: start at the smallest that is well above rounding, and halve it a few times.
    steps = steps[steps > 4 * spacing]
    if len(steps) == 0:
        return None
    for parts in (1, 2, 3, 4, 5, 6):
        quantum = refined(values, float(steps.min()) / parts, spacing)
        if quantum is None:
            continue
        k = np.round((finite - values[0]) / quantum)
        error = np.abs(k * quantum + values[0] - finite).max()
        if error <= 1.5 * spacing and k.max() < 2**30 and quantum > 4 * spacing:
            return k.astype(np.int32)
    return None


def refined(values, quantum, spacing):
    """The quantum that fits all values, found over a range that grows with the accuracy; None if there is none."""
    reach = 4.0 * quantum
    while True:
        near = values[values - values[0] <= reach]
        k = np.round((near - values[0]) / quantum)
        if k.max() > 0:
            quantum = float((k * (near - values[0])).sum() / (k * k).sum())
            if np.abs(k * quantum - (near - values[0])).max() > 2 * spacing + 0.2 * quantum:
                return None
        if len(near) == len(values):
            return quantum
        reach *= 2.0


def planes(columns):
    """The bytes of little-endian columns by significance, channel after channel."""
    return b"".join(column.view(np.uint8).reshape(-1, 4).T.tobytes() for column in columns)


def differences(columns, order):
    """Integer columns after `order` differences that wrap; float columns as integers of their bits."""
    columns = [column.view(np.int32) for column in columns]
    for _ in range(order):
        columns = [np.diff(column, prepend=np.int32(0)).astype(np.int32) for column in columns]
    return columns


def packed(compress):
    """A general compressor at its best of interleaved samples, columns, and planes after 0 to 2 differences."""

    def size(columns):
        layouts = [np.stack(columns, 1).tobytes(), b"".join(column.tobytes() for column in columns)]
        layouts += [planes(differences(columns, order)) for order in (0, 1, 2)]
        return min(len(compress(layout)) for layout in layouts)

    return size


def pcodec(columns):
    return sum(len(standalone.simple_compress(c, ChunkConfig(compression_level=12))) for c in columns)


def audio(command, suffix, channels, formats):
    """The size of audio files of up to `channels` channels each, less that of files of one row."""

    def one(columns, folder):
        is_float = columns[0].dtype == np.float32
        subtype = formats["float" if is_float else "int"]
        if subtype is None:
            return math.inf
        total = 0
        rows = np.stack(columns, 1)
        if subtype == "PCM_24":
            if np.abs(rows).max() >= 2**23:
                return math.inf
            # The library takes the upper 24 bits of 32.
            rows = rows << 8
        for part, sign in ((rows, 1), (rows[:1], -1)):
            wav, out = folder / "samples.wav", folder / f"samples{suffix}"
            out.unlink(missing_ok=True)
            soundfile.write(wav, part, 48000, subtype=subtype)
            name = ["-o", str(out)] if suffix == ".wv" else [f"--output-name={out}"]
            subprocess.run([*command, str(wav), *name], check=True, capture_output=True)
            total += sign * out.stat().st_size
        return total

    def size(columns):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            groups = [columns[at : at + channels] for at in range(0, len(columns), channels)]
            return min(sum(one(g, folder) for g in groups), sum(one([c], folder) for c in columns))

    return size


PEERS = {
    "xz -9e": packed(lambda data: lzma.compress(data, preset=9 | lzma.PRESET_EXTREME)),
    "zstd -19": packed(zstandard.ZstdCompressor(level=19).compress),
    "brotli -11": packed(lambda data: brotli.compress(data, quality=11, lgwin=24)),
    "pcodec -12": pcodec,
    "WavPack -hhx6": audio(WAVPACK, ".wv", 16, {"float": "FLOAT", "int": "PCM_32"}),
    "FLAC -8": audio(FLAC, ".flac", 8, {"float": None, "int": "PCM_24"}),
}


def analog(path):
    """The analog channels of a C3D file as float32 columns; empty if it has none."""
    data = ezc3d.c3d(str(path), ignore_bad_formatting=True)["data"]["analogs"][0]
    return [np.ascontiguousarray(channel, np.float32) for channel in data]


def peer_sizes(columns):
    """Bytes by peer, without and with the lattice."""
    integers = [lattice(column) for column in columns]
    plain = [c for c, k in zip(columns, integers) if k is None]
    on_lattice = [(c, k) for c, k in zip(columns, integers) if k is not None]
    rows = {}
    for name, size in PEERS.items():
        of_floats = size(columns)
        rows[name] = of_floats
        if on_lattice:
            # What is on no lattice is stored by the peer as it is, or, if it cannot, by xz.
            rest = min(size(plain), math.inf) if plain else 0
            if math.isinf(rest):
                rest = PEERS["xz -9e"](plain)
            rows[f"{name} + lattice"] = min(of_floats, size([k for _, k in on_lattice]) + rest)
    return rows, len(on_lattice)


def own_size(program, path):
    with tempfile.TemporaryDirectory() as folder:
        take = Path(folder) / "samples.take"
        subprocess.run([program, "import", path, "-o", take], check=True, capture_output=True)
        info = subprocess.run([program, "info", take, "--json", "--markers"], check=True, capture_output=True, text=True)
        groups = json.loads(info.stdout)["sampled_groups"]
        return sum(group["stored_bytes"] for group in groups if group["kind"] == "c3d/analog")


def mean(factors):
    return math.exp(sum(map(math.log, factors)) / len(factors))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--mocapd", metavar="PATH", help="default: target/release/mocapd")
    parser.add_argument("--check", action="store_true", help="exit code 1 when a claim does not hold")
    options = parser.parse_args()
    program = ours_.find(options.mocapd)
    factors = {name: [] for name in BARS}
    names = list(PEERS) + [f"{name} + lattice" for name in PEERS]
    print("| file | float32 | channels (on a lattice) | " + " | ".join(names) + " | mocapd |")
    print("|---" * (len(names) + 4) + "|")
    for path in sorted(p for p in options.folder.iterdir() if p.suffix.lower() == ".c3d"):
        try:
            columns = analog(path)
        except OSError as error:
            print(f"left out: {path.name}: {error}", file=sys.stderr)
            continue
        if not columns or not columns[0].size:
            continue
        rows, n_on_lattice = peer_sizes(columns)
        own = own_size(program, path)
        cells = [str(rows.get(name, "")).replace("inf", "") for name in names]
        raw = sum(column.nbytes for column in columns)
        print(f"| {path.stem} | {raw} | {len(columns)} ({n_on_lattice}) | {' | '.join(cells)} | {own} |", flush=True)
        factors["best peer"].append(min(rows[name] for name in PEERS) / own)
        factors["best peer + lattice"].append(min(rows.values()) / own)
    missed = False
    for name, bar in BARS.items():
        if factors[name]:
            print(f"\n{name}: {mean(factors[name]):.3f} times the bytes of mocapd, least {min(factors[name]):.3f}")
            missed |= mean(factors[name]) < bar
    return 1 if options.check and missed else 0


if __name__ == "__main__":
    sys.exit(main())
