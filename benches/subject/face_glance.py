"""Trains the initial landmark regression, three linear stages: `subject/face/data/face-glance.bin`.

    python3 benches/subject/heads/make.py DATA targets.npz HEADS 0 5000             # random heads
    python3 benches/subject/heads/make.py DATA targets.npz HEADS 10000 10500 80     # turned ones
    cargo build --release --locked -p mocapd-face --features measure --example face_glance
    python3 benches/subject/face_glance.py HEADS subject/face/data/face-glance.bin
    python3 benches/subject/face_glance.py HEADS held                                # errors on held-out heads

Needs numpy. The example `face_glance` prints the features of each head for four random perturbations of its eyes and mouth.
The stages are ridge regressions (Xiong and De la Torre 2013) to the 24 principal directions of landmark motion, trained with
every head and its mirror image. The second and third stage are trained on the out-of-fold predictions of the stages before.
Features are centred for the training; the constants of a stage contain the correction.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

LANDMARKS = [*range(28), 30, *range(31, 60), 62, 66]
WAYS, RIDGES, FOLDS, STARTS = 24, (30.0, 30.0, 30.0), 4, 4
# Width of the crop in pixels; the midpoint of the eyes is at half of it.
WIDE_PX = 224.0
CELLS, PATCHES = (16, 14, 9), (60, 2, 2, 8)
TURNED = [4, 3, 2, 1, 0, 7, 6, 5]

OTHER_SIDE = {i: 16 - i for i in range(17)} | {i: 43 - i for i in range(17, 27)} | {i: i for i in (27, 30, 33, 51, 57, 62, 66)}
OTHER_SIDE |= {31: 35, 32: 34, 34: 32, 35: 31, 36: 45, 37: 44, 38: 43, 39: 42, 40: 47, 41: 46}
OTHER_SIDE |= {42: 39, 43: 38, 44: 37, 45: 36, 46: 41, 47: 40} | {i: 102 - i for i in (48, 49, 50, 52, 53, 54)}
OTHER_SIDE |= {i: 114 - i for i in (55, 56, 58, 59)}
SIDES = np.array([LANDMARKS.index(OTHER_SIDE[i]) for i in LANDMARKS])


def mirrored_points(points):
    out = points[:, SIDES].copy()
    out[..., 0] = WIDE_PX - out[..., 0]
    return out


def mirrored_moves(moves):
    return moves[:, SIDES] * [-1, 1]


def mirrored_look(look):
    if look.shape[1] == np.prod(CELLS):
        return look.reshape(-1, *CELLS)[:, :, ::-1][..., [*TURNED, 8]].reshape(len(look), -1)
    return look.reshape(-1, *PATCHES)[:, SIDES][:, :, :, ::-1][..., TURNED].reshape(len(look), -1)


def rows(heads, points=None):
    """The landmarks (rows x 60 x 2, pixels of the crop) and the features (rows x bytes)."""
    example = Path(os.environ.get("CARGO_TARGET_DIR", "target")) / "release/examples/face_glance"
    length = int(np.prod(CELLS if points is None else PATCHES))
    if points is None:
        output = subprocess.run([example, "cells", heads], capture_output=True, check=True).stdout
    else:
        with tempfile.NamedTemporaryFile() as file:
            file.write(points.astype("<f4").tobytes())
            file.flush()
            output = subprocess.run([example, "patches", heads, file.name], capture_output=True, check=True).stdout
    table = np.frombuffer(output, np.uint8).reshape(-1, 480 + length)
    return np.ascontiguousarray(table[:, :480]).view("<f4").reshape(-1, 60, 2).astype(float), table[:, 480:]


class Stage:
    """One regression in the format of the table, with weights as bytes."""

    def __init__(self, look, moves, ridge):
        x = np.concatenate([look, mirrored_look(look)]).astype(np.float32)
        y = moves.reshape(len(x), -1)
        mean, self.mean = x.mean(0, dtype=float), y.mean(0)
        x -= mean.astype(np.float32)
        x /= 128
        square = (x.T @ x).astype(float) + ridge * np.eye(x.shape[1])
        found = np.linalg.solve(square, x.T @ (y - self.mean))
        self.ways = np.linalg.svd(x @ found.astype(np.float32), full_matrices=False)[2][:WAYS].astype(float)
        weights = found @ self.ways.T / 128
        self.unit = np.abs(weights).max(0) / 127
        self.weights = np.round(weights / self.unit)
        self.added = -(mean @ self.weights) * self.unit

    def predict(self, look):
        amounts = (look.astype(np.float32) @ self.weights.astype(np.float32)) * self.unit + self.added
        return (self.mean + amounts @ self.ways).reshape(len(look), -1, 2)

    def bytes(self):
        numbers = np.concatenate([self.mean, self.ways.ravel(), self.added, self.unit])
        return numbers.astype("<f4").tobytes() + self.weights.astype(np.int8).tobytes()


def learned(heads, part, fold):
    """The stages trained on `part` of the rows, the true landmarks, and the predicted landmarks after each stage."""
    truth, look = rows(heads)
    at, stages, predicted = np.zeros_like(truth), [], []
    for number, ridge in enumerate(RIDGES):
        if number:
            look = rows(heads, at)[1]
        moves = truth - at
        both = lambda these: np.concatenate([moves[these], (mirrored_moves if number else mirrored_points)(moves[these])])
        stages.append(Stage(look[part], both(part), ridge))
        after = at + stages[-1].predict(look)
        for k in range(FOLDS):
            others, these = part[fold[part] != k], part[fold[part] == k]
            after[these] = at[these] + Stage(look[others], both(others), ridge).predict(look[these])
        at = after
        predicted.append(at)
    return stages, truth, predicted


def off(truth, at):
    """Mean error over eyes, brows, nose and mouth, in per cent of the distance between the outer eye corners."""
    far = np.hypot(*np.moveaxis(at - truth, 2, 0))
    apart = np.hypot(*(truth[:, LANDMARKS.index(45)] - truth[:, LANDMARKS.index(36)]).T)
    return 100 * far[:, [i for i, point in enumerate(LANDMARKS) if 17 <= point < 27 or point > 30]].mean(1) / apart


def main(heads, to):
    head = np.arange(len(list(Path(heads).glob("*.png"))) * STARTS) // STARTS
    fold = head % FOLDS
    if to != "held":
        stages, truth, predicted = learned(heads, np.arange(len(head)), fold)
        Path(to).write_bytes(b"".join(stage.bytes() for stage in stages))
        test = np.arange(len(head))
    else:
        test = np.flatnonzero(head % 5 == 4)
        _, truth, predicted = learned(heads, np.flatnonzero(head % 5 != 4), (head // 5) % FOLDS)
    for number, at in enumerate(predicted, 1):
        for start in range(STARTS):
            errors = off(truth, at)[test[test % STARTS == start]]
            print(f"stage {number}, start {start}: median {np.median(errors):.2f}, under 10: {100 * (errors < 10).mean():.1f} %")


if __name__ == "__main__":
    main(*sys.argv[1:3])
