"""Makes pictures of animals and objects for `find_again.py`: negatives that resemble faces.

    apt-get download tuxpaint-stamps-default && dpkg -x tuxpaint-stamps-default_*.deb DEBIAN
    python3 benches/subject/find_animals.py STAMPS WORK

Needs numpy, scipy, pillow, and scikit-image and scikit-learn, whose pictures without faces are backgrounds. STAMPS is
DEBIAN/usr/share/tuxpaint/stamps, the stamps of Tux Paint, version 2022.06.04 of Debian (GPL 2, Bill Kendrick and others).
Nearly all are cut-out photographs: 128 of animals, 184 of food, plants, tools, instruments, signs and vehicles. None of
these shows a human face; people, clothes, feasts, coins, space and soldiers, among others, and all cartoons are left out.
The seed is fixed. Stamps and pictures are divided into three folds. Stamps whose names begin with the same word, which may
show the same animal or be mirror images, share a fold, so that an animal is held out with all its pictures.

Writes WORK/animals/animalsK_NNNN.png: up to three stamps of random size on the backgrounds of the random heads.
"""

import re
import sys
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parent / "heads"))
from backgrounds import backgrounds  # noqa: E402
from picture import clutter, developed  # noqa: E402

ANIMALS = ("animals",)
THINGS = ("food", "household", "plants", "hobbies", "town", "vehicles")
PICTURES, THIRDS = 2700, 3
WIDE, HIGH = 440, 380


def stamps(folder, kinds):
    paths = [path for kind in kinds for path in sorted((folder / kind).rglob("*.png")) if "cartoon" not in path.parts]
    words = [re.match("[A-Za-z]*", path.stem)[0].lower() for path in paths]
    third = {word: i % THIRDS for i, word in enumerate(sorted(set(words)))}
    return [[Image.open(path).convert("RGBA") for path, word in zip(paths, words) if third[word] == i] for i in range(THIRDS)]


def stamped(image, stamp, random):
    """Draws a stamp of 150 to 1100 pixels at a random place, with random mirroring, roll and light."""
    scale = np.exp(random.uniform(np.log(150), np.log(1100))) / max(stamp.size)
    scale = min(scale, 5)
    stamp = stamp.resize([max(8, int(side * scale)) for side in stamp.size], Image.BICUBIC)
    stamp = stamp.transpose(Image.FLIP_LEFT_RIGHT) if random.random() < 0.5 else stamp
    stamp = stamp.rotate(random.normal(0, 12), Image.BICUBIC, expand=True)
    pixels = np.asarray(stamp, np.float32) / 255
    light = 1 + np.clip(random.normal(0, 0.4), -0.9, 0.9) * np.linspace(-1, 1, pixels.shape[1])[None, :, None]
    pixels[..., :3] = np.clip(pixels[..., :3], 0, 1) ** np.exp(random.normal(0, 0.3)) * light
    # A random point of the stamp coincides with a random point of the picture.
    x, y = (int(random.uniform(0.1, 0.9) * whole - random.uniform(0.15, 0.85) * part)
            for whole, part in ((WIDE, pixels.shape[1]), (HIGH, pixels.shape[0])))
    left, top, right, bottom = max(0, x), max(0, y), min(WIDE, x + pixels.shape[1]), min(HIGH, y + pixels.shape[0])
    if right > left and bottom > top:
        piece, part = pixels[top - y : bottom - y, left - x : right - x], image[top:bottom, left:right]
        part += piece[..., 3:] * (piece[..., :3] - part)


def main(folder, work):
    if not folder.is_dir():
        sys.exit(f"{folder}: not a folder; expected the stamps of Tux Paint")
    animals, things, behind = stamps(folder, ANIMALS), stamps(folder, THINGS), backgrounds()
    work.mkdir(parents=True, exist_ok=True)
    for number in range(PICTURES):
        random, third = np.random.default_rng([20042, number]), number % THIRDS
        image = clutter(WIDE, HIGH, behind, random)
        for _ in range(random.integers(1, 4)):
            these = animals[third] if random.random() < 0.75 else things[third]
            stamped(image, these[random.integers(len(these))], random)
        developed(image, random).save(work / f"animals{third}_{number:04}.png")


main(Path(sys.argv[1]), Path(sys.argv[2]) / "animals")
