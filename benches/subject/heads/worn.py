"""Occlusions of the face: fringes, caps, hoods and beards of random shape, as textures projected from the front."""

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from parts import LANDMARKS
from raster import normals

# Width of a texture in pixels and in decimetres; its centre is between the eyes.
SIDE, WIDE = 512, 4.0
# Least height of the lower edge of a fringe above the eyes, in decimetres: the lids stay visible.
LIDS = 0.13


def layer(base, triangles, picture, out, alpha_min):
    """The triangles of the head, slightly offset, with a texture projected from the front."""
    eyes = base[[LANDMARKS[i] for i in range(36, 48)]].mean(0)
    front = triangles[base[triangles, 2].min(1) > eyes[2] - 1.4]
    uv = (base[:, :2] - eyes[:2]) / WIDE + 0.5
    return base + out * normals(base, triangles), front, uv, front, picture, alpha_min


def grid():
    """Coordinates in decimetres, to the right of and above the midpoint of the eyes."""
    at = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * WIDE
    return at[None, :], -at[:, None]


def wave(random, rough):
    """A random curve along the x axis, about -1 to 1, with features of `rough` decimetres."""
    line = gaussian_filter1d(random.normal(size=SIDE), rough * SIDE / WIDE, mode="wrap")
    return line / (np.abs(line).max() + 1e-9)


def strands(random, colour, across):
    """Hair: lighter and darker streaks, vertical or, with `across`, without direction."""
    streaks = gaussian_filter(random.normal(size=(SIDE, SIDE)), (2 if across else 25, 1.2))
    light = np.exp(random.uniform(0.1, 0.5) * streaks / streaks.std())
    return light[..., None] * colour


def covering(colour, alpha):
    return np.dstack([np.broadcast_to(colour, (SIDE, SIDE, 3)), np.broadcast_to(alpha, (SIDE, SIDE))])


def fringe(random, colour):
    """Hair over the forehead down to an irregular line, parted or not, often over the brows."""
    x, y = grid()
    line = random.uniform(LIDS, 0.6) + random.uniform(0, 0.15) * wave(random, 0.25) + random.uniform(0, 0.12) * wave(random, 0.03)
    parting = random.uniform(-0.5, 0.5)
    line = line + random.uniform(0, 0.5) * np.exp(-(((x[0] - parting) / random.uniform(0.1, 0.3)) ** 2)) * (random.random() < 0.5)
    line = np.maximum(line + random.normal(0, 0.25) * x[0], LIDS)
    return covering(strands(random, colour, False), np.clip((y - line) / random.uniform(0.01, 0.12), 0, 1))


def cloth(random):
    x, y = grid()
    colour, other = random.random((2, 3)) ** 1.5
    stripes = random.random() < 0.3
    way = random.normal(size=2) * random.uniform(2, 15)
    share = (0.5 + 0.5 * np.sign(np.sin(way[0] * x + way[1] * y)))[..., None] * stripes
    return colour + share * (other - colour)


def cap(random):
    """A cap or a headband, down to a smooth line above the brows."""
    x, y = grid()
    line = random.uniform(0.2, 0.65) + random.normal(0, 0.12) * x**2 + random.normal(0, 0.08) * x
    return covering(cloth(random), (y > np.maximum(line, LIDS)).astype(float))


def hood(random):
    """The oval outside of which a hood, a scarf or hair on both cheeks covers the head."""
    x, y = grid()
    oval = np.hypot((x - random.normal(0, 0.05)) / random.uniform(0.58, 0.85), (y + random.uniform(0.25, 0.45)) / random.uniform(0.75, 1.15))
    return oval + random.uniform(0, 0.04) * wave(random, 0.05)


def beard(base, random, colour):
    """Hair on chin, cheeks and upper lip: from stubble to thick, with the lips left free."""
    x, y = grid()
    at = lambda i: (base[LANDMARKS[i]] - base[[LANDMARKS[i] for i in range(36, 48)]].mean(0))[:2]
    mouth, nose = np.mean([at(i) for i in range(48, 60)], 0), at(33)
    half = (at(54)[0] - at(48)[0]) / 2
    lips = np.hypot((x - mouth[0]) / (half * random.uniform(0.95, 1.15)), (y - mouth[1]) / random.uniform(0.1, 0.16))
    up = mouth[1] + random.uniform(-0.1, 0.2) + random.uniform(0.2, 0.9) * np.abs(x) ** 2
    jaw = y < up if random.random() < 0.75 else (np.abs(x) < half * random.uniform(0.6, 1.2)) & (y < mouth[1])
    lip = (np.abs(x) < half * random.uniform(0.9, 1.5)) & (y < nose[1] - 0.02) & (y > mouth[1] - 0.3)
    there = jaw | lip if random.random() < 0.8 else (lip & (y > mouth[1] - 0.02))
    there = gaussian_filter((there & (lips > 1)).astype(float), random.uniform(1, 7))
    return covering(strands(random, colour, random.random() < 0.5), random.uniform(0.4, 1) * there)


def worn(person, parts, random, hair):
    """Adds layers to a person that cover more of the face than its own hair and beard."""
    def add(picture, out, alpha_min):
        person.add(*layer(person.base, parts.triangles, picture, out, alpha_min))

    if random.random() < 0.4:
        add(beard(person.base, random, hair), 0.015, 0.15)
    kind = random.random()
    if kind < 0.4:
        add(fringe(random, hair), random.uniform(0.04, 0.1), 0.2)
    elif kind < 0.55:
        add(cap(random), random.uniform(0.05, 0.1), 0.2)
    elif kind < 0.65:
        oval = hood(random)
        colour = cloth(random) if random.random() < 0.6 else strands(random, hair, False)
        add(covering(colour, (oval > 1).astype(float)), random.uniform(0.03, 0.09), 0.2)
