"""Trains the first-stage face classifier of `face/find`, which rejects false matches of the template:
`subject/face/data/face-first-trees.bin`.

    DATA=subject/face/data BUILD="cargo build --release --locked -p mocapd-face --features measure --example faces_found"
    $BUILD && python3 benches/subject/find_pictures.py $MOCAPD_FACES WORK              # pictures with known faces
    python3 benches/subject/heads/make.py MAKEHUMAN targets.npz WORK/heads 0 2000           # random heads
    python3 benches/subject/find_align.py WORK first > $DATA/face-align-first.bin && $BUILD
    python3 benches/subject/find_align.py WORK second > $DATA/face-align-second.bin && $BUILD
    python3 benches/subject/find_looks.py WORK > $DATA/face-first-trees.bin && $BUILD
    python3 benches/subject/find_looks.py WORK held                                    # detections on held-out pictures

Needs the packages of these scripts. The example `faces_found` prints the features of all candidates of a picture. The result
is deterministic, because all seeds are fixed. Training data: the pictures of `find_pictures.py`; random heads; six variants
of each picture without faces, rotated, scaled, with other light and inverted; heads upside down. A candidate is a face if
both eyes are within 0.2 of the distance between the outer eye corners and the mouth within 0.3. Other candidates with the
eyes within 0.45 are left out, as are those on faces with a yaw of more than 50 degrees or with an eye hidden by hair. Each
face has the weight 1. Negatives are the eight best candidates of a picture and eight random others; after half of the rounds,
the fifteen with the highest scores of the trees are added once.
"""

import json
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parent / "heads"))
import boost  # noqa: E402

SCORES, LOOK, WIDE = 8, 1000, 10
MIRRORED = np.arange(LOOK).reshape(WIDE, WIDE, 10)[:, ::-1][..., [4, 3, 2, 1, 0, 7, 6, 5, 8, 9]].ravel()
COUNTS = {"head": 1.0, "lfw": 1.0, "drawn": 0.3}
ROUNDS, RATE, RIDGE, TRIED, FACES_SHARE = 300, 0.1, 5.0, 60, 0.15
# Subtracted from the score: one in a hundred held-out pictures without faces has a candidate above it.
ZERO, HELD = 0.3, 3
UPSIDE_DOWN = 160


def without_faces(work):
    """Writes six variants of each picture without faces, and heads upside down."""
    random, folder = np.random.default_rng(5), work / "neg"
    if folder.exists():
        return
    folder.mkdir()
    for path in sorted(work.glob("none_*.png")):
        if path.stem.endswith("_half"):
            continue
        image = Image.open(path).convert("RGB")
        for i in range(6):
            degrees = random.uniform(-180, 180) if i % 2 else random.uniform(-40, 40)
            scale = random.uniform(0.35, 1.1) * min(1, 700 / max(image.size))
            size = [max(60, int(side * scale)) for side in image.size]
            turned = image.resize(size, Image.LANCZOS).rotate(degrees, Image.BICUBIC, expand=True)
            wide, high = turned.size
            turned = turned.crop((int(wide * 0.17), int(high * 0.17), int(wide * 0.83), int(high * 0.83)))
            pixels = np.asarray(turned, float) / 255
            pixels = 1 - pixels if i in (2, 3) else pixels
            pixels = pixels ** np.exp(random.normal(0, 0.4))
            pixels = pixels[:, ::-1] if i == 4 else pixels
            Image.fromarray((255 * pixels.clip(0, 1)).astype("uint8")).save(folder / f"{path.stem}_n{i}.png")
    for path in sorted((work / "heads").glob("head_*.png"))[:UPSIDE_DOWN]:
        Image.open(path).transpose(Image.ROTATE_180).save(folder / f"up_{path.stem}.png")


def looks(paths, which="looks", length=LOOK):
    """Yields the positions and the features of the candidates of each picture."""
    finder = Path(os.environ.get("CARGO_TARGET_DIR", "target")) / "release/examples/faces_found"

    def output_of(part):
        return subprocess.run([finder, which, *map(str, part)], capture_output=True, check=True).stdout

    parts = [paths[first : first + 50] for first in range(0, len(paths), 50)]
    with ThreadPoolExecutor(2) as two:
        for part, output in zip(parts, two.map(output_of, parts)):
            at = 0
            for _ in part:
                count = int(np.frombuffer(output, "<f4", 1, at)[0])
                row = 4 * SCORES + length
                rows = np.frombuffer(output, np.uint8, count * row, at + 4).reshape(count, row)
                at += 4 + count * row
                yield np.ascontiguousarray(rows[:, : 4 * SCORES]).view("<f4"), rows[:, 4 * SCORES :]


def label(places, faces):
    """Labels of the candidates (1 a face, 0 no face, -1 to be ignored), and the index of the face."""
    kind, which = np.zeros(len(places), int), np.full(len(places), -1)
    for i, face in enumerate(faces):
        far = np.hypot(*np.moveaxis(places[:, :6].reshape(-1, 3, 2) - np.array(face["points"]), 2, 0)) / face["io"]
        good, near = (far[:, :2].max(1) < 0.2) & (far[:, 2] < 0.3), far[:, :2].max(1) < 0.45
        if abs(face["yaw"]) > 50 or not all(face.get("shown", [True])):
            near, good = far[:, :2].max(1) < (1 if abs(face["yaw"]) > 50 else 0.45), good & False
        kind[near & (kind == 0)] = -1
        kind[good], which[good | near] = 1, i
    return kind, which


class Rows:
    """All candidates: features, label, weight, and index of the picture."""

    def __init__(self, work):
        paths, self.faces = pictures(work)
        negatives = sorted((work / "neg").glob("*.png"))
        paths, self.faces = paths + negatives, self.faces + [[] for _ in negatives]
        self.source = ["none" if p.parent.name == "neg" else re.match("[a-z]+", p.stem)[0] for p in paths]
        stems = [re.sub(r"^up_|_(v|n)\d$|_half$", "", p.stem) for p in paths]
        family = sorted(set(stems))
        look, kind, which, count, picture = [], [], [], [], []
        for i, (places, seen) in enumerate(looks(paths)):
            is_face, one = label(places, self.faces[i])
            counts = [COUNTS.get(self.source[i], 1.5) / max(1, ((is_face == 1) & (one == k)).sum()) for k in one]
            look.append(seen)
            kind.append(is_face)
            which.append(one)
            count.append(np.where(is_face == 1, counts, 1.0))
            picture.append(np.full(len(places), i))
        self.look, self.kind, self.which, self.count, self.picture = map(np.concatenate, (look, kind, which, count, picture))
        self.fold = np.array([family.index(stem) % HELD for stem in stems])[self.picture]

    def chosen(self, part, sums, surest, others, random):
        kept = [part[self.kind[part] == 1]]
        for picture in np.unique(self.picture[part]):
            none = part[(self.picture[part] == picture) & (self.kind[part] == 0)]
            none = none[np.argsort(-sums[none], kind="stable")]
            kept += [none[:surest], random.permutation(none[surest:])[:others]]
        return np.unique(np.concatenate(kept))

    def learn(self, part):
        """Trains the trees. The candidates of a picture are in descending order of the template score."""
        random = np.random.default_rng(1)
        kept = self.chosen(part, -np.arange(len(self.kind)), 8, 8, random)
        for rounds in (ROUNDS // 2, ROUNDS):
            faces, count = np.tile(self.kind[kept] == 1, 2), np.tile(self.count[kept], 2)
            count = np.where(faces, count * len(count) / count[faces].sum() * FACES_SHARE, count)
            rows = np.vstack([self.look[kept], self.look[kept][:, MIRRORED]])
            found = boost.learn(rows, faces.astype(float), count, rounds, RATE, RIDGE, TRIED, np.random.default_rng(1))
            if rounds != ROUNDS:
                sums = np.zeros(len(self.kind))
                sums[part] = self.sums(found, part)
                kept = np.union1d(kept, self.chosen(part, sums, 15, 0, random))
        return found

    def sums(self, found, part):
        return (boost.scores(self.look[part], *found) + boost.scores(self.look[part][:, MIRRORED], *found)) / 2 - ZERO


def pictures(work):
    """Paths of the pictures with known faces or none, and the faces on each."""
    truth = json.loads((work / "truth.json").read_text())
    heads = sorted((work / "heads").glob("head_*.png"))
    known = [json.loads(path.with_suffix(".json").read_text())["faces"] for path in heads]
    return [work / f"{name}.png" for name in truth] + heads, list(truth.values()) + known


def print_results(rows, sums):
    """Prints detected faces and false detections on held-out pictures for several limits of the score."""
    best, false = {}, {}
    for i, faces in enumerate(rows.faces):
        here = np.flatnonzero(rows.picture == i)
        none = sums[here[rows.kind[here] == 0]]
        false.setdefault(rows.source[i], []).append(none.max(initial=-99))
        for k, face in enumerate(faces):
            if face["io"] >= 33 and abs(face["yaw"]) <= 35.5 and all(face.get("shown", [True])):
                mine = sums[here[(rows.kind[here] == 1) & (rows.which[here] == k)]]
                best.setdefault(rows.source[i], []).append(mine.max(initial=-99))
    for name in sorted(false):
        found, wrong = np.array(best.get(name, [])), np.array(false[name])
        print(f"{name}: {len(found)} faces, never seen {(found < -98).sum()};", end="")
        for limit in (-1, -0.5, 0, 0.5, 1):
            print(f" at {limit}: {(found > limit).sum()} found, {(wrong > limit).mean():.3f};", end="")
        print(" lowest", np.sort(found[found > -98])[:5].round(1).tolist())


def main(work, held):
    without_faces(work)
    rows = Rows(work)
    everything = np.arange(len(rows.kind))
    if held:
        sums = np.zeros(len(everything))
        for k in range(HELD):
            sums[rows.fold == k] = rows.sums(rows.learn(np.flatnonzero(rows.fold != k)), np.flatnonzero(rows.fold == k))
        return print_results(rows, sums)
    bias, trees = rows.learn(everything)
    sys.stdout.buffer.write(boost.table(bias - ZERO, trees))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:] == ["held"])
