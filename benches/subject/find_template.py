"""Trains the gradient templates of `face/find`: `subject/face/data/face-template.bin`.

    python3 benches/subject/find_pictures.py $MOCAPD_FACES WORK  # pictures with known faces
    python3 benches/subject/find_template.py WORK > subject/face/data/face-template.bin

Needs the packages and pictures of `find_pictures.py`: the original development photographs, the 100 faces and 100 other
patches of scikit-image's subset of LFW, drawn faces, and pictures without faces. The templates are two logistic regressions,
frontal (symmetric) and turned, on four gradient components in each of ten by ten cells. Each face is mirrored, and shifted,
scaled and rolled within the step size of the search. The false detections of the template are added to the negatives in two
further rounds.
"""

import json
import math
import re
import sys
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates

EYES_PX, SIDE, LEFT, TOP = 8.0, 10, -1.25, -0.75
SIZE = SIDE * SIDE * 4
MIRRORED = np.arange(SIZE).reshape(SIDE, SIDE, 4)[:, ::-1][..., [1, 0, 2, 3]].ravel()
ROLLS, STEP, RIDGE, ROUNDS = (0, -15, 15, -30, 30), 1.2, 1.0, 3
# Number of shifts of a face, and its weight.
KINDS = {"photo": (6, 1.0), "synth": (6, 0.3), "lfw": (6, 0.5), "drawn": (2, 0.15)}

def cells(grey):
    """The gradient features of a picture, identical to those of find/template.rs."""
    root = np.sqrt(np.maximum(grey, 0))
    wide = np.pad(root, 1, mode="edge")
    dx, dy = wide[1:-1, 2:] - wide[1:-1, :-2], wide[2:, 1:-1] - wide[:-2, 1:-1]
    high, long = grey.shape[0] // 2, grey.shape[1] // 2
    slopes = np.stack([np.maximum(dx, 0), np.maximum(-dx, 0), np.maximum(dy, 0), np.maximum(-dy, 0), dx**2 + dy**2], -1)
    pooled = slopes[: 2 * high, : 2 * long].reshape(high, 2, long, 2, 5).mean((1, 3))
    contrast = np.sqrt(gaussian_filter(pooled[..., 4], 3.0, mode="nearest", truncate=3)) + 0.25
    wide = np.pad(np.minimum(pooled[..., :4] / contrast[..., None], 2), ((1, 1), (1, 1), (0, 0)), mode="edge")
    tall = (wide[:-2] + 2 * wide[1:-1] + wide[2:]) / 4
    return (tall[:, :-2] + 2 * tall[:, 1:-1] + tall[:, 2:]) / 4


def patch(grey, points, shift, scale, roll, mirrored):
    """The cells of one face, rotated upright."""
    left, right, mouth = points
    middle, across = (left + right) / 2, right - left
    # Yaw shortens the distance of the eyes, pitch that of the mouth: the scale is the mean of both.
    eyes = scale * (np.hypot(*across) + np.hypot(*(mouth - middle)) / 1.1) / 2
    turn = math.atan2(across[1], across[0]) + roll
    pixels = (np.arange(44) - 21.5) / EYES_PX
    x, y = np.meshgrid(pixels + shift[0], pixels + 0.5 + shift[1])
    x = -x if mirrored else x
    at = [middle[1] + eyes * (x * math.sin(turn) + y * math.cos(turn)), middle[0] + eyes * (x * math.cos(turn) - y * math.sin(turn))]
    smooth = gaussian_filter(grey, 0.45 * eyes / EYES_PX) if eyes > EYES_PX else grey
    return cells(map_coordinates(smooth, at, order=1, mode="nearest"))[6:16, 6:16].ravel()


def levels(grey, io_min):
    """For each size and roll: the cells, and a function from the corner of a window to the midpoint of the eyes."""
    shrink = io_min / 1.43 / EYES_PX
    image = Image.fromarray(grey.astype(np.float32))
    while min(grey.shape) / shrink >= 16:
        size = (max(1, round(image.width / shrink)), max(1, round(image.height / shrink)))
        small = np.asarray(image.resize(size, Image.BOX if shrink >= 1 else Image.BILINEAR))
        for roll in ROLLS:
            sin, cos = math.sin(math.radians(roll)), math.cos(math.radians(roll))
            wide, high = (int(abs(a) * size[0] + abs(b) * size[1]) + 16 for a, b in ((cos, sin), (sin, cos)))
            x, y = np.meshgrid(np.arange(wide) - (wide - 1) / 2, np.arange(high) - (high - 1) / 2)
            at = [sin * x + cos * y + (size[1] - 1) / 2, cos * x - sin * y + (size[0] - 1) / 2]
            turned = map_coordinates(small, at, order=1, mode="nearest")

            def place(column, row, shrink=shrink, sin=sin, cos=cos, wide=wide, high=high, size=size):
                dx = 2 * column - LEFT * EYES_PX - 0.5 - (wide - 1) / 2
                dy = 2 * row - TOP * EYES_PX - 0.5 - (high - 1) / 2
                px, py = cos * dx - sin * dy + (size[0] - 1) / 2, sin * dx + cos * dy + (size[1] - 1) / 2
                return (px + 0.5) * shrink - 0.5, (py + 0.5) * shrink - 0.5

            yield cells(turned), place
        shrink *= STEP


def windows(field):
    view = np.lib.stride_tricks.sliding_window_view(field, (SIDE, SIDE), axis=(0, 1))
    return view.transpose(0, 1, 3, 4, 2).reshape(-1, SIZE), view.shape[1]


def near(at, faces):
    return any(np.hypot(*(at - (face["points"][0] + face["points"][1]) / 2)) < face["io"] for face in faces)


def logistic(scores, faces, weights):
    mean = np.average(scores, axis=0, weights=weights)
    deviation = np.sqrt(np.average((scores - mean) ** 2, axis=0, weights=weights)) + 1e-3
    columns = np.c_[(scores - mean) / deviation, np.ones(len(scores))]
    found, penalty = np.zeros(columns.shape[1]), np.diag([RIDGE] * scores.shape[1] + [1e-9])
    for _ in range(12):
        p = 1 / (1 + np.exp(-np.clip(columns @ found, -30, 30)))
        slope = columns.T @ (weights * (faces - p)) - penalty @ found
        found = found + np.linalg.solve((columns * (weights * p * (1 - p))[:, None]).T @ columns + penalty, slope)
    plain = found[:-1] / deviation
    return np.r_[plain, found[-1] - plain @ mean]


def learn(frontal, turned, none):
    """The three templates: frontal, turned to the right, turned to the left."""
    pairs = sorted({tuple(sorted((i, j))) for i, j in enumerate(MIRRORED)})
    tie = np.zeros((SIZE, len(pairs)))
    for column, pair in enumerate(pairs):
        tie[list(pair), column] = 1
    total = sum(count for _, count in frontal)
    out = []
    for faces, by in ((frontal, tie), (turned, np.eye(SIZE))):
        count = np.array([count for _, count in faces])
        each = 12 * (total if faces is frontal else count.sum()) / len(none)
        rows = np.r_[np.array([row for row, _ in faces]), none] @ by
        found = logistic(rows, np.r_[np.ones(len(faces)), np.zeros(len(none))], np.r_[count, np.full(len(none), each)])
        out.append(np.r_[by @ found[:-1], found[-1]])
    return np.array([out[0], out[1], np.r_[out[1][:-1][MIRRORED], out[1][-1]]])


def main(work):
    random = np.random.default_rng(1)
    truth = json.loads((work / "truth.json").read_text())
    pictures, frontal, turned = [], [], []
    for name, faces in truth.items():
        if re.search(r"_v\d$|_half$", name):
            continue
        kind = next((kind for kind in KINDS if name.startswith(kind)), "none" if name.startswith("none") else "photo")
        image = Image.open(work / f"{name}.png").convert("L")
        # The LFW patches were enlarged three times.
        image = image.resize((25, 25), Image.BOX) if kind == "lfw" else image
        by = 3 if kind == "lfw" else 1
        faces = [dict(f, points=[(np.array(p) + 0.5) / by - 0.5 for p in f["points"]], io=f["io"] / by) for f in faces]
        grey = np.asarray(image, float)
        pictures.append((kind, grey, faces))
        for face in faces:
            if face["io"] < 11 or abs(face["yaw"]) > 47:
                continue
            left, right, mouth = face["points"]
            to_right = np.dot(mouth - (left + right) / 2, right - left)
            to_right = face["yaw"] if kind == "drawn" else to_right
            times, counts = KINDS[kind]
            for mirrored in [False, True] * times:
                shift, scale = random.uniform(-0.1, 0.1, 2), math.exp(random.uniform(-0.1, 0.1))
                row = patch(grey, face["points"], shift, scale, random.uniform(-0.14, 0.14), mirrored)
                if abs(face["yaw"]) <= 28:
                    frontal.append((row, counts / times))
                if abs(face["yaw"]) > 18 and (to_right > 0) != mirrored:
                    turned.append((row, 2 * counts / times))
    none, places = [], []
    others = [p for i, p in enumerate(pictures) if p[0] not in ("lfw", "drawn") or not p[2] or (p[0] == "drawn" and i % 40 == 0)]
    templates = None
    for _ in range(ROUNDS):
        for kind, grey, faces in others:
            found = []
            for field, place in levels(grey, 12 if kind == "lfw" else 34):
                if min(field.shape[:2]) < SIDE:
                    continue
                rows, across = windows(field)
                if templates is None:
                    best, fits = random.integers(len(rows), size=9 if kind != "lfw" else 2), np.zeros(len(rows))
                else:
                    fits = (rows @ templates[:, :-1].T + templates[:, -1]).max(1)
                    best = np.argsort(-fits)[:8]
                for i in best:
                    if not near(np.array(place(i % across, i // across)), faces):
                        found.append((fits[i], rows[i].copy()))
            found.sort(key=lambda one: -one[0])
            none += [row for _, row in (found if templates is None else found[: 4 if kind == "lfw" else 60])]
        templates = learn(frontal, turned, np.array(none))
    write(templates, np.array([row for row, _ in frontal]))


def write(templates, frontal):
    eyes = templates[:, :-1].reshape(3, SIDE, -1)[:, 1:4].reshape(3, -1)
    sums = (frontal.reshape(len(frontal), SIDE, -1)[:, 1:4].reshape(len(frontal), -1) @ eyes.T).max(1)

    # The first percentile of the score of the eye rows, the biases, the left half of the frontal template, the turned one.
    head = [f"{np.percentile(sums, 1):.2f}", *(f"{bias:.3f}" for bias in templates[:2, -1])]
    halves = templates[0, :-1].reshape(SIDE, SIDE, 4)[:, :5], templates[1, :-1]
    weights = [f"{weight:.2f}" for half in halves for weight in half.ravel()]
    sys.stdout.buffer.write(np.array([float(number) for number in head + weights], "<f4").tobytes())


main(Path(sys.argv[1]))
