"""Backgrounds for heads and animals: the pictures without faces in scikit-image and scikit-learn."""

from pathlib import Path

import numpy as np
import skimage
import sklearn
from PIL import Image

WITHOUT_FACES = [
    "brick.png", "chelsea.png", "coffee.png", "coins.png", "color.png", "grass.png", "gravel.png", "hubble_deep_field.jpg",
    "ihc.png", "motorcycle_left.png", "page.png", "retina.jpg", "rocket.jpg", "text.png",
]


def backgrounds():
    paths = [Path(skimage.__file__).parent / "data" / name for name in WITHOUT_FACES]
    paths += [Path(sklearn.__file__).parent / "datasets/images" / name for name in ("china.jpg", "flower.jpg")]
    out = []
    for path in paths:
        image = Image.open(path).convert("RGB")
        image.thumbnail((900, 900))
        out.append(np.asarray(image, np.float32) / 255)
    return out
