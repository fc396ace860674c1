"""Draws docs/picture.svg from what `mocapd demo` writes: a generated standing long jump, then some steps.

    python3 docs/picture/draw.py [--mocapd target/release/mocapd] [--out docs/picture.svg]

Needs nothing but Python. It runs the demo, reads which samples the take keeps (tests/reference, the decoder in
plain Python), checks their number against `mocapd info --json`, and stops when it differs.
"""

import argparse
import csv
import json
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "reference"))
from take.stretch import read_take  # noqa: E402, from the folder above

WIDTH, HEIGHT = 1200, 800
MARGIN = 36
INK, DIM, FAINT, CARD, PANEL = "#e8edf4", "#93a1b5", "#2c3a50", "#0f1622", "#162033"
KEPT, LINE = "#ffd060", "#58a0ff"
COLOURS = [(79, 150, 255), (178, 118, 245), (255, 116, 96)]  # of the figures, first to last

BONES = "pelvis-throat throat-head throat-{0}_shoulder {0}_shoulder-{0}_elbow {0}_elbow-{0}_wrist " \
        "pelvis-{0}_hip {0}_hip-{0}_knee {0}_knee-{0}_ankle"
FIGURES = [322, 436, 472, 486, 499, 512, 525, 538, 554, 640, 722, 782, 845, 905, 965]
MARKER = "r_wrist"
JUMP_S = (3.0, 5.5)  # the part of the take that the curve shows
GROUND = 440  # height of the floor on the page
SCALE = 0.186  # of the picture to a millimetre
LEFT_MM = -560


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mocapd", default="target/release/mocapd")
    parser.add_argument("--out", default="docs/picture.svg", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([arguments.mocapd, "demo", "--out", folder], check=True, stdout=subprocess.DEVNULL)
        take = Path(folder) / "jump-001.take"
        answer = subprocess.run([arguments.mocapd, "info", "--json", take], check=True, capture_output=True, text=True)
        info = json.loads(answer.stdout)
        tracks = read_csv(take.with_suffix(".csv"))
        sizes = {end: take.with_suffix(end).stat().st_size for end in (".csv", ".c3d")}
        decoded = read_take(take.read_bytes())
    labels = [channel["label"] for channel in info["channels"]]
    samples = decoded.tracks[labels.index(MARKER)]
    kept = sorted(row for row, (_, is_kept) in samples.items() if is_kept)
    stated = next(c["knots"] for c in info["channels"] if c["label"] == MARKER)
    if len(kept) != stated:
        raise SystemExit(f"found {len(kept)} kept samples of {MARKER}, the take says {stated}")
    parts = stage(tracks, kept, info["tolerance_mm"]) + curve(tracks[MARKER], kept, info) + bars(info, sizes) + flow()
    arguments.out.write_text(svg(parts), encoding="utf-8")


def read_csv(path):
    """Positions in millimetres by marker."""
    with open(path, newline="", encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    labels = [name.removesuffix(".x") for name in names[2::3]]
    cells = [[float(cell) for cell in row[2:]] for row in rows]
    return {label: [tuple(row[3 * i : 3 * i + 3]) for row in cells] for i, label in enumerate(labels)}


def stage(tracks, kept, tolerance_mm):
    """The figures along the path, seen from the side, and one wrist's way through the air."""
    parts = [line(MARGIN, GROUND, WIDTH - MARGIN, GROUND, FAINT, 1.5)]
    for metres in range(0, 6):
        x = page_x(1000 * metres)
        parts += [line(x, GROUND, x, GROUND + 6, FAINT, 1.5), text(x, GROUND + 24, f"{metres} m", DIM, 15, "middle")]
    parts.append(text(WIDTH - MARGIN, GROUND - 12, "generated motion", DIM, 15, "end"))
    for index, frame in enumerate(FIGURES):
        pose = {label: track[frame] for label, track in tracks.items()}
        parts += figure(pose, between(index / (len(FIGURES) - 1)))
    way = [(page_x(x), page_y(z)) for x, _, z in tracks[MARKER]]
    parts.append(polyline(way[::2], KEPT, 1.2, 0.4))
    parts.append(dots([way[row] for row in kept], KEPT, 4.6))
    right = WIDTH - MARGIN
    parts.append(text(right, 48, "The samples that a take keeps", INK, 23, "end", 600))
    parts.append(text(right, 77, "Every dot is a kept sample of the right wrist. The others are", DIM, 16, "end"))
    words = f"rebuilt from them, each within {tolerance_mm:g} mm of where the device saw it."
    parts.append(text(right, 98, words, DIM, 16, "end"))
    return parts


def figure(points, colour):
    """One pose: the far side of the body dim, the near side bright."""
    at = {label: (page_x(x), page_y(z)) for label, (x, _, z) in points.items()}
    parts = []
    for side, opacity in (("l", 0.38), ("r", 0.95)):
        bones = [bone.split("-") for bone in BONES.format(side).split()]
        path = "".join(f"M{n(at[a][0])} {n(at[a][1])}L{n(at[b][0])} {n(at[b][1])}" for a, b in bones)
        parts.append(
            f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="3.4" stroke-linecap="round" opacity="{opacity}"/>'
        )
    x, y = at["head"]
    parts.append(f'<circle cx="{n(x)}" cy="{n(y)}" r="10.5" fill="{CARD}" stroke="{colour}" stroke-width="3.4"/>')
    return parts


def curve(track, kept, info):
    """Height of the wrist while it jumps: every sample, and the kept ones."""
    left, top, width, height = MARGIN, 492, 700, 150
    first, last = (round(s * info["rate_hz"]) for s in JUMP_S)
    heights = [z for _, _, z in track[first : last + 1]]
    low, high = min(heights), max(heights)

    def at(row):
        x = left + 18 + (width - 36) * (row - first) / (last - first)
        return x, top + height - 28 - (height - 76) * (heights[row - first] - low) / (high - low)

    shown = [row for row in kept if first <= row <= last]
    parts = [panel(left, top, width, height)]
    parts.append(dots([at(row) for row in range(first, last + 1)], LINE, 2.6))
    parts.append(dots([at(row) for row in shown], KEPT, 5.4))
    words = f"height of the wrist: {len(shown)} of {last - first + 1} samples kept"
    parts.append(text(left + 18, top + 27, words, INK, 16.5))
    whole = f"whole take: {thousands(len(kept))} of {thousands(len(track))}"
    parts.append(text(left + width - 18, top + 27, whole, DIM, 15, "end"))
    parts.append(text(left + 18, top + height - 9, f"{JUMP_S[0]:g} s", DIM, 14))
    parts.append(text(left + width - 18, top + height - 9, f"{JUMP_S[1]:g} s", DIM, 14, "end"))
    return parts


def bars(info, sizes):
    """What the same motion weighs."""
    left, top, width, height = MARGIN + 720, 492, WIDTH - 2 * MARGIN - 720, 150
    rows = [
        ("CSV", sizes[".csv"], DIM),
        ("C3D", sizes[".c3d"], DIM),
        ("float32", info["raw_bytes"], DIM),
        ("take", info["file_bytes"], KEPT),
    ]
    parts = [panel(left, top, width, height)]
    words = f"{info['markers']} markers at {info['rate_hz']:g} Hz, {info['seconds']:g} s"
    parts.append(text(left + 18, top + 27, words, INK, 16.5))
    room = width - 36 - 62 - 84
    for index, (name, size, colour) in enumerate(rows):
        y = top + 43 + 25 * index
        long = room * size / max(size for _, size, _ in rows)
        parts.append(text(left + 18, y + 13, name, DIM if colour == DIM else INK, 15))
        parts.append(f'<rect x="{left + 80}" y="{y + 1}" width="{n(long)}" height="15" rx="2" fill="{colour}"/>')
        parts.append(text(left + 88 + long, y + 13, f"{size / 1000:.1f} kB", DIM if colour == DIM else KEPT, 15))
    return parts


def flow():
    """From the device to the file."""
    top, height, gap = 662, 102, 40
    steps = [
        ("device", "a rig on a serial line,", "or the simulator"),
        ("a ring per marker", "lock-free, bounded; a frame", "goes in whole or is counted"),
        ("resampler pool", "each marker at its own times;", "every error is measured"),
        ("take", "append-only, checksummed;", "readable wherever it was cut"),
    ]
    width = (WIDTH - 2 * MARGIN - gap * (len(steps) - 1)) / len(steps)
    parts = []
    for index, (name, *words) in enumerate(steps):
        x = MARGIN + index * (width + gap)
        parts.append(panel(x, top, width, height))
        parts.append(text(x + 18, top + 32, name, KEPT if name == "take" else INK, 18, weight=600))
        parts += [text(x + 18, top + 58 + 19 * i, word, DIM, 15) for i, word in enumerate(words)]
        if index:
            middle = top + height / 2
            parts.append(line(x - gap + 7, middle, x - 10, middle, DIM, 2))
            parts.append(f'<path d="M{n(x - 15)} {n(middle - 6)}l9 6l-9 6" fill="none" stroke="{DIM}" stroke-width="2"/>')
    return parts


def between(part):
    """The colour of a figure, 0 the first and 1 the last."""
    at = part * (len(COLOURS) - 1)
    index = min(int(at), len(COLOURS) - 2)
    mixed = (a + (b - a) * (at - index) for a, b in zip(COLOURS[index], COLOURS[index + 1]))
    return "#" + "".join(f"{round(value):02x}" for value in mixed)


def page_x(millimetres):
    return MARGIN + (millimetres - LEFT_MM) * SCALE


def page_y(millimetres):
    return GROUND - millimetres * SCALE


def n(value):
    return f"{value:.1f}".removesuffix(".0")


def thousands(value):
    return f"{value:,}".replace(",", " ")


def panel(x, y, width, height):
    return f'<rect x="{n(x)}" y="{n(y)}" width="{n(width)}" height="{n(height)}" rx="8" fill="{PANEL}"/>'


def line(x1, y1, x2, y2, colour, width):
    return f'<path d="M{n(x1)} {n(y1)}L{n(x2)} {n(y2)}" stroke="{colour}" stroke-width="{width}"/>'


def polyline(points, colour, width, opacity):
    path = "M" + "L".join(f"{n(x)} {n(y)}" for x, y in points)
    return f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="{width}" opacity="{opacity}" stroke-linejoin="round"/>'


def dots(points, colour, width):
    path = "".join(f"M{n(x)} {n(y)}h0" for x, y in points)
    return f'<path d="{path}" stroke="{colour}" stroke-width="{width}" stroke-linecap="round"/>'


def text(x, y, words, colour, size, anchor="start", weight=400):
    return f'<text x="{n(x)}" y="{n(y)}" fill="{colour}" font-size="{size}" text-anchor="{anchor}" font-weight="{weight}">{words}</text>'


def svg(parts):
    fonts = "system-ui, -apple-system, 'Segoe UI', Helvetica, Arial, sans-serif"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="{fonts}" role="img">\n'
        "<title>A jump as stick figures, the samples of one wrist that the take keeps, and the way from device to take</title>\n"
        f'<rect width="{WIDTH}" height="{HEIGHT}" rx="14" fill="{CARD}"/>\n' + "\n".join(parts) + "\n</svg>\n"
    )


if __name__ == "__main__":
    main()
