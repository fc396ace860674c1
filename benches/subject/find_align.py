"""Trains the two regressions that align eyes and mouth: `subject/face/data/face-align-first.bin`, and on its results
`face-align-second.bin`.

    python3 benches/subject/find_align.py WORK first > subject/face/data/face-align-first.bin     # then build again
    python3 benches/subject/find_align.py WORK second > subject/face/data/face-align-second.bin   # then build again
    python3 benches/subject/find_align.py WORK second held       # or first: errors on held-out pictures

Needs the packages and pictures of `find_looks.py`. Ridge regressions from the features of a candidate, and of its mirror
image, to the offsets of eyes and mouth from the template (first) or from the first regression (second), in coordinates of
the face. Candidates for the training have both eyes within 0.42 of the distance between the outer eye corners, the mouth
within 0.7, and offsets of at most 0.8 in these coordinates. Each face has the weight 1, drawn ones 0.3. Faces with a yaw of
more than 47 degrees, or with an eye hidden by hair, are left out.
"""

import re
import sys
from pathlib import Path

import numpy as np

from find_looks import LOOK, MIRRORED, looks, pictures

RIDGE, UNIT = 10.0, 1e-6
# The mode of `faces_found` for the training data of each regression.
STEPS = {"first": "rough", "second": "nearer"}
MIDDLE = np.array([[-0.5, 0], [0.5, 0], [0, 1.1]])
# Mirroring swaps the eyes.
SIDES, SIGNS = np.array([2, 3, 0, 1, 4, 5]), np.array([-1, 1, -1, 1, -1, 1])

def off(places, points):
    """Offsets of the true eyes and mouth from the candidates, in the coordinates that each candidate defines."""
    found = places[:, :6].reshape(-1, 3, 2).astype(float)
    origin = (found[:, 0] + found[:, 1]) / 2
    way = np.stack([found[:, 1] - found[:, 0], (found[:, 2] - origin) / 1.1], 2)
    inside = np.linalg.solve(way[:, None], (points[None] - origin[:, None])[..., None])[..., 0]
    return (inside - MIDDLE).reshape(-1, 6)


class Seen:
    """Candidates near a face: features, offsets of eyes and mouth, weight, index of the face, index of the picture."""

    def __init__(self, work, step):
        look, moves, count, face, picture = [], [], [], [], []
        self.paths, known = pictures(work)
        for i, (path, faces, (places, seen)) in enumerate(zip(self.paths, known, looks(self.paths, STEPS[step]))):
            for one in faces:
                if abs(one["yaw"]) > 47 or not all(one.get("shown", [True])):
                    continue
                points = np.array(one["points"])
                far = np.hypot(*np.moveaxis(places[:, :6].reshape(-1, 3, 2) - points, 2, 0)) / one["io"]
                near = (far[:, :2].max(1) < 0.42) & (far[:, 2] < 0.7)
                near[near] = np.abs(off(places[near], points)).max(1) <= 0.8
                if near.any():
                    look.append(seen[near])
                    moves.append(off(places[near], points))
                    count.append(np.full(near.sum(), (0.3 if path.stem.startswith("drawn") else 1) / near.sum()))
                    face.append(np.full(near.sum(), len(face)))
                    picture.append(np.full(near.sum(), i))
        self.look, self.moves, self.count, self.face, self.picture = map(np.concatenate, (look, moves, count, face, picture))

    def learn(self, part):
        """The constants, and the weights of the 1000 features divided by 128."""
        count = np.tile(self.count[part], 2)
        rows = np.vstack([self.look[part], self.look[part][:, MIRRORED]]).astype(np.float32) / 128
        moves = np.vstack([self.moves[part], self.moves[part][:, SIDES] * SIGNS])
        mean, shift = np.average(rows, axis=0, weights=count), np.average(moves, axis=0, weights=count)
        columns = (rows - mean) * np.sqrt(count)[:, None].astype(np.float32)
        square = (columns.T @ columns).astype(float) + RIDGE * np.eye(LOOK)
        found = np.linalg.solve(square, columns.T @ ((moves - shift) * np.sqrt(count)[:, None]))
        return shift - mean @ found, found

    def predict(self, part, added, found):
        own, other = (self.look[part][:, order] / 128 @ found + added for order in (np.arange(LOOK), MIRRORED))
        return (own + other[:, SIDES] * SIGNS) / 2


def held(seen):
    """Prints the errors of eyes and mouth before and after, on held-out pictures, in units of the eye distance."""
    stems = [re.sub(r"_v\d$", "", path.stem) for path in seen.paths]
    family = sorted(set(stems))
    fold = np.array([family.index(stem) % 2 for stem in stems])[seen.picture]
    after = seen.moves.copy()
    for k in range(2):
        after[fold == k] -= seen.predict(fold == k, *seen.learn(fold != k))
    kind = np.array([re.match("[a-z]+", path.stem)[0] for path in seen.paths])[seen.picture]
    for name in ("head", "drawn", "aflw", "menpo", "obama", "synth", "lfpw", "dlib", "lfw"):
        figures = []
        for moves in (seen.moves[kind == name], after[kind == name]):
            far = np.hypot(*np.moveaxis(moves.reshape(-1, 3, 2), 2, 0))
            figures += [np.median(far[:, :2].max(1)), np.median(far[:, 2])]
            figures += [((far[:, :2].max(1) < 0.286) & (far[:, 2] < 0.43)).mean()]
        print(name, (kind == name).sum(), "eyes %.3f, mouth %.3f, good %.3f; then %.3f, %.3f, %.3f" % tuple(figures))


def main(work, step, is_held):
    seen = Seen(work, step)
    if is_held:
        return held(seen)
    added, found = seen.learn(slice(None))
    # The constants with four decimals, then the weights, feature by feature.
    sys.stdout.buffer.write(np.array([float(f"{value:.4f}") for value in added], "<f4").tobytes())
    sys.stdout.buffer.write(np.round(found / 128 / UNIT).clip(-32768, 32767).astype("<i2").tobytes())


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], sys.argv[3:] == ["held"])
