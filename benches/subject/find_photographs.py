"""Makes pictures from photographs of animals, landscapes and buildings without faces, as negatives for `find_again.py`.

    apt-get download gcompris-qt-data && dpkg -x gcompris-qt-data_*.deb DEBIAN
    python3 benches/subject/find_photographs.py RESOURCES WORK

Needs numpy and pillow. RESOURCES is DEBIAN/usr/share/gcompris-qt/rcc, the resources of GCompris, version 3.1 of Debian
(GPL 3 and free licences of its photographers). Each file contains WebP pictures, numbered in their order. Pictures of statues
and people are left out; apes count as animals. The seeds are fixed.

Writes WORK/gcompris/NAME_NNN_K.png: several variants of each photograph with random size, rotation and light. The variants
of a photograph belong to one fold.
"""

import io
import struct
import sys
from pathlib import Path

import numpy as np
from PIL import Image

# For each file: the pictures that are left out, and the number of variants of the others.
FILES = {
    "erase": ((), 8),
    "explore_farm_animals": ((), 8),
    "explore_world_animals": ((), 8),
    "explore_monuments": ((27, 29, 33, 39), 4),
    "categorization": ((98, 100, 110, 118), 2),
}
SIDE_MOST_PX = 1400


def pictures(resource):
    at = resource.find(b"RIFF")
    while at >= 0:
        end = at + 4
        if resource[at + 8 : at + 12] == b"WEBP":
            end = at + 8 + struct.unpack_from("<I", resource, at + 4)[0]
            yield Image.open(io.BytesIO(resource[at:end])).convert("RGB")
        at = resource.find(b"RIFF", end)


def changed(image, random):
    scale = min(np.exp(random.uniform(np.log(0.35), np.log(1.2))), SIDE_MOST_PX / max(image.size))
    scale = max(scale, 260 / min(image.size))
    image = image.resize([int(side * scale) for side in image.size], Image.LANCZOS)
    image = image.transpose(Image.FLIP_LEFT_RIGHT) if random.random() < 0.5 else image
    image = image.rotate(random.normal(0, 12), Image.BICUBIC, expand=True)
    wide, high = image.size
    image = image.crop((int(wide * 0.08), int(high * 0.08), int(wide * 0.92), int(high * 0.92)))
    pixels = (np.asarray(image, np.float32) / 255) ** np.exp(random.normal(0, 0.3))
    if random.random() < 0.2:
        pixels = np.repeat(pixels.mean(2, keepdims=True), 3, 2)
    return Image.fromarray((255 * pixels.clip(0, 1)).astype("uint8"))


def main(folder, work):
    work.mkdir(parents=True, exist_ok=True)
    for name, (left_out, times) in FILES.items():
        for number, image in enumerate(pictures((folder / f"{name}.rcc").read_bytes()), 1):
            for i in range(0 if number in left_out else times):
                random = np.random.default_rng([20043, *name.encode(), number, i])
                changed(image, random).save(work / f"{name}_{number:03}_{i}.png")


main(Path(sys.argv[1]), Path(sys.argv[2]) / "gcompris")
