"""The trees of `face/find` that tell a face at the second look, as `find/second_trees.rs`.

    python3 benches/subject/find_animals.py STAMPS WORK                                # pictures of animals and things
    cargo build --release --locked -p mocapd-subject --example faces_found
    python3 benches/subject/find_again.py WORK > subject/src/face/find/second_trees.rs # then build again
    python3 benches/subject/find_again.py WORK held [MORE]                             # what is found when held out

Needs what `find_looks.py` needs, its pictures (`find_pictures.py`, heads/make.py, what it made itself of those without
faces) and its trees: what the first look does not dismiss is looked at again, where a glance has eyes and mouth
(`points/glance`, so `face_glance.py` comes first). A second look is a look there, what lies around every landmark, and how
sure the first one was. Photographs count three times, drawn faces a third. MORE is another folder of random heads, none of
which is learned from. Seeded: the same twice.
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

AGAIN = len(MIRRORED) + int(np.prod(face_glance.PATCHES)) + 1
AROUND = face_glance.mirrored_look(np.arange(np.prod(face_glance.PATCHES))[None])[0]
TURNED = np.concatenate([MIRRORED, len(MIRRORED) + AROUND, [AGAIN - 1]])
PHOTOGRAPHS = re.compile("lfw|lfpw|aflw|dlib|menpo|obama")
ROUNDS, RATE, RIDGE, TRIED, FACES_SHARE = 150, 0.1, 5.0, 120, 0.4


class Rows:
    """Everything that is looked at again: how it looks, whether it is a face, which one, and of which picture."""

    def __init__(self, work, more):
        paths, self.faces = pictures(work)
        without = sorted((work / "neg").glob("*.png")) + sorted((work / "animals").glob("*.png"))
        others = sorted(Path(more).glob("*.png")) if more else []
        self.faces += [[] for _ in without] + [json.loads(p.with_suffix(".json").read_text())["faces"] for p in others]
        paths = paths + without + others
        self.kind_of = [self.named(path, others) for path in paths]
        stems = [re.sub(r"^up_|_(v|n)\d$|_half$|(?<=^animals\d)_.*", "", path.stem) for path in paths]
        family = sorted(set(stems))
        fold = np.array([HELD if kind == "more" else family.index(stem) % HELD for stem, kind in zip(stems, self.kind_of)])
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
    def named(path, others):
        if path in others:
            return "more"
        if path.parent.name in ("neg", "animals"):
            return path.parent.name
        return "photographs" if PHOTOGRAPHS.match(path.stem) else re.match("[a-z]+", path.stem)[0]

    def learn(self, part):
        part = part[self.kind[part] >= 0]
        faces = np.tile(self.kind[part] == 1, 2)
        counts = {"photographs": 3.0, "drawn": 0.3}
        count = np.tile([counts.get(source, 1.0) for source in self.source[part]], 2)
        count = np.where(faces, count, 1.0)
        count = np.where(faces, count * count[~faces].sum() / count[faces].sum() * FACES_SHARE / (1 - FACES_SHARE), count)
        rows = np.vstack([self.look[part], self.look[part][:, TURNED]])
        count *= len(count) / count.sum()
        return boost.learn(rows, faces.astype(float), count, ROUNDS, RATE, RIDGE, TRIED, np.random.default_rng(1))

    def tell(self, sums):
        """What is found of the faces that count, and how many others are, by limits of the sum."""
        for limit in (-1, -0.5, 0, 0.5, 1, 1.5):
            line = []
            for source in sorted(set(self.kind_of)):
                faces = found = 0
                for i in (i for i, kind in enumerate(self.kind_of) if kind == source):
                    here = self.picture == i
                    good = set(self.which[here & (self.kind == 1) & (sums > limit)])
                    for k, face in enumerate(self.faces[i]):
                        if face["io"] >= 36 and abs(face["yaw"]) <= 35.5 and all(face.get("shown", [True])):
                            faces, found = faces + 1, found + (k in good)
                false = ((self.source == source) & (self.kind == 0) & (sums > limit)).sum()
                line.append(f"{source} {found} of {faces}, {false} false on {self.kind_of.count(source)}")
            print(f"{limit}: " + "; ".join(line))


HEADER = """\
//! What faces look like at a second look, learned by `benches/subject/find_again.py`: trees of three questions each, boosted.

use super::verdict::Tree;

/// In thousandths: what is added to the trees.
pub(super) const BIAS: i32 = %d;

#[rustfmt::skip]
pub(super) static TREES: [Tree; %d] = ["""


def main(work, held, more=None):
    rows = Rows(work, more)
    if held:
        sums = np.zeros(len(rows.kind))
        for k in range(HELD):
            found = rows.learn(np.flatnonzero((rows.fold != k) & (rows.fold < HELD)))
            part = np.flatnonzero((rows.fold == k) | (rows.fold == HELD))
            sums[part] += boost.scores(rows.look[part], *found) / np.where(rows.fold[part] == HELD, HELD, 1)
        return rows.tell(sums)
    bias, trees = rows.learn(np.flatnonzero(rows.fold < HELD))
    print(HEADER % (round(1000 * bias), len(trees)))
    for asked, limits, leaves in trees:
        print(f"    ({list(map(int, asked))}, {list(map(int, limits))}, {[round(1000 * float(leaf)) for leaf in leaves]}),")
    print("];")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:3] == ["held"], *sys.argv[3:4])
