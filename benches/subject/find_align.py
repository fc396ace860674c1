"""Where eyes and mouth are, by how a face looks in a rough frame, as `find/align_weights.rs`.

    python3 benches/subject/find_align.py WORK > subject/src/face/find/align_weights.rs

Needs what `find_looks.py` needs, and its pictures. A ridge regression from a look, and its mirror image, to how far eyes and
mouth are from where the drawn face has them, in the face's own coordinates. Learned on what the search proposes within
0.42 of the outer eye corners' distance (the mouth within 0.7) and at most 0.8 of the frame off; each face counts once, drawn
ones 0.3. Faces turned by more than 47 degrees, or with an eye that hair hides, are left out.
"""

import sys
from pathlib import Path

import numpy as np

from find_looks import LOOK, MIRRORED, looks, pictures

RIDGE, UNIT = 10.0, 1e-6
MIDDLE = np.array([[-0.5, 0], [0.5, 0], [0, 1.1]])
# In the mirror the eyes change sides.
SIDES, SIGNS = np.array([2, 3, 0, 1, 4, 5]), np.array([-1, 1, -1, 1, -1, 1])

HEADER = """\
//! Where eyes and mouth are, by how a face looks: learned by `benches/subject/find_align.py` as a ridge regression.

use super::look::LOOK;

/// Weights are told in these: shares of the distance of the eyes for a byte.
pub(super) const UNIT: f32 = 1e-6;

/// What is added: x and y of the left eye, the right one, the mouth.
pub(super) const ADDED: [f32; 6] = [%s];

/// For each byte of a look, how it moves the same six.
#[rustfmt::skip]
pub(super) const WEIGHTS: [[i16; 6]; LOOK] = ["""


def off(places, points):
    """How far eyes and mouth are from those found, in coordinates that those give."""
    found = places[:, :6].reshape(-1, 3, 2).astype(float)
    origin = (found[:, 0] + found[:, 1]) / 2
    way = np.stack([found[:, 1] - found[:, 0], (found[:, 2] - origin) / 1.1], 2)
    inside = np.linalg.solve(way[:, None], (points[None] - origin[:, None])[..., None])[..., 0]
    return (inside - MIDDLE).reshape(-1, 6)


def main(work):
    rows, moves, weights = [], [], []
    paths, known = pictures(work)
    for path, faces, (places, seen) in zip(paths, known, looks(paths, "rough")):
        for face in faces:
            if abs(face["yaw"]) > 47 or not all(face.get("shown", [True])):
                continue
            points = np.array(face["points"])
            far = np.hypot(*np.moveaxis(places[:, :6].reshape(-1, 3, 2) - points, 2, 0)) / face["io"]
            near = (far[:, :2].max(1) < 0.42) & (far[:, 2] < 0.7)
            if near.any():
                rows.append(seen[near])
                moves.append(off(places[near], points))
                weights.append(np.full(near.sum(), (0.3 if path.stem.startswith("drawn") else 1) / near.sum()))
    rows, moves, weights = map(np.concatenate, (rows, moves, weights))
    kept = np.abs(moves).max(1) <= 0.8
    rows, moves, weights = rows[kept], moves[kept], np.tile(weights[kept], 2)
    rows = np.vstack([rows, rows[:, MIRRORED]]).astype(np.float32) / 128
    moves = np.vstack([moves, moves[:, SIDES] * SIGNS])
    mean, shift = np.average(rows, axis=0, weights=weights), np.average(moves, axis=0, weights=weights)
    columns = (rows - mean) * np.sqrt(weights)[:, None]
    square = (columns.T @ columns).astype(float) + RIDGE * np.eye(LOOK)
    found = np.linalg.solve(square, columns.T @ ((moves - shift) * np.sqrt(weights)[:, None]))
    print(HEADER % ", ".join(f"{value:.4f}" for value in shift - mean @ found))
    table = np.round(found / 128 / UNIT).astype(int).tolist()
    for i in range(0, LOOK, 5):
        print("    " + ", ".join(map(str, table[i : i + 5])) + ",")
    print("];")


main(Path(sys.argv[1]))
