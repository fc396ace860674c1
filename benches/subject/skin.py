"""Fits the Gaussian model of skin colour (Yang et al. 2004, eqs. 1 and 2) to the colour photographs of the development set.

    python3 benches/subject/skin.py $MOCAPD_FACES

Needs numpy and pillow. Skin is the area inside the outline of the landmarks (jaw and brows) without eyes, brows and lips.
Every face has the same weight, whatever its size. The printed values are the constants of subject/face/src/paper/mod.rs.
"""

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

DEVELOPMENT = [
    "aflw2000_image00050", "aflw2000_image01322", "aflw2000_image02616", "dlib_2007_007763",
    "dlib_2008_002470", "lfpw_0001", "obama",
]
OUTLINE = [*range(17), *range(26, 16, -1)]
HOLES = [range(17, 22), range(22, 27), range(36, 42), range(42, 48), range(48, 60)]


def faces(folder):
    for name in DEVELOPMENT:
        picture = next(path for path in folder.glob(name + ".*") if path.suffix != ".json")
        truth = picture.with_suffix(".json")
        known = json.loads((truth if truth.exists() else picture.with_suffix(".proxy.json")).read_text())
        for face in known["faces"] if isinstance(known, dict) else known:
            yield picture, np.array(face.get("landmarks") or face["dlib68"])[:, :2]


def chromaticities(picture, points):
    rgb = np.asarray(Image.open(picture).convert("RGB"), float)
    mask = Image.new("L", rgb.shape[1::-1])
    draw = ImageDraw.Draw(mask)
    draw.polygon([tuple(points[i]) for i in OUTLINE], fill=255)
    width = max(1, int(np.hypot(*(points[45] - points[36])) / 12))
    for hole in HOLES:
        draw.polygon([tuple(points[i]) for i in hole], fill=0, outline=0)
        draw.line([tuple(points[i]) for i in hole], fill=0, width=width)
    skin = rgb[np.asarray(mask) > 0]
    skin = skin[(skin.sum(1) > 60) & (skin.max(1) < 250)]
    return skin[:, :2] / skin.sum(1, keepdims=True)


def main(folder):
    rng = np.random.default_rng(1)
    samples = []
    for picture, points in faces(folder):
        found = chromaticities(picture, points)
        if len(found) >= 100:
            samples.append(found[rng.integers(0, len(found), 1000)])
    samples = np.concatenate(samples)
    print("mean", samples.mean(0).round(4), "covariance", np.cov(samples.T).round(6).tolist())


main(Path(sys.argv[1]) / "photos")
