"""Trains the girth models of knee, elbow and wrist, a mean profile and its principal components, for
subject/body/data/girths.json. Part of learn.py."""

import dataclasses

import numpy as np

STEP = 0.006  # limb.rs
EVERY = 2 * STEP  # model.rs
# Standard deviations of height and slope of a profile: larger than between people, so that they carry no information.
HEIGHT, SLOPE = 0.5, 0.3
# Residual standard deviation at each level, in the logarithm of the girth or as a fraction of it.
REST = 0.04


@dataclasses.dataclass
class Place:
    """A section of a limb where the girth is measured: levels relative to the joint, in body scales."""

    name: str
    limb: str
    joint: str
    within: tuple  # levels between which the joint is
    first: float
    places: int
    modes: int
    logarithm: bool


PLACES = [
    # From below the thickest of the calf to the middle of the thigh.
    Place("knee", "leg", "knee", (0.2, 0.48), -0.12, 23, 6, True),
    # From the thinner half of the forearm to the lower part of the upper arm.
    Place("elbow", "arm", "elbow", (0.17, 0.36), -0.096, 14, 4, False),
    # From the middle of the hand to the thickest of the forearm.
    Place("wrist", "arm", "wrist", (0.06, 0.2), -0.036, 10, 4, False),
]


def level_nearest(line, at, within):
    """The level, within a range, at which the centre line (levels x 3) is closest to a joint, and the distance there."""
    levels = (np.arange(len(line)) + 1) * STEP
    distances = np.where((levels > within[0]) & (levels < within[1]), np.linalg.norm(line - at, axis=1), np.inf)
    best = int(np.argmin(distances))
    along = line[best + 1] - line[best - 1]
    return levels[best] + np.clip((at - line[best]) @ along / (along @ along) * 2, -1, 1) * STEP, distances[best]


def profiles(bodies, place):
    """The girth profile around each true joint, in body scales."""
    for body in bodies:
        for half in body["halves"]:
            line, length = np.array(half[f"{place.limb}_line"]), np.array(half[f"{place.limb}_girth"])
            joints = [np.array(body["joints"][f"{place.joint}.{side}"]) / body["scale"] for side in "LR"]
            nearest, _ = min((level_nearest(line, joint, place.within) for joint in joints), key=lambda found: found[1])
            at = nearest + place.first + EVERY * np.arange(place.places)
            yield np.interp(at, (np.arange(len(length)) + 1) * STEP, length)


def learn(bodies, place):
    """The average girth, the mean profile, and the modes scaled as model.rs takes them: probabilistic principal components
    (Tipping and Bishop 1999), with height and slope of the profile left free."""
    found = np.array(list(profiles(bodies, place)))
    average = found.mean()
    found = np.log(found) if place.logarithm else found / average
    mean = found.mean(axis=0)
    level = np.ones(place.places)
    slope = np.arange(place.places) - (place.places - 1) / 2
    slope /= slope.std()
    shapes = found - mean
    shapes -= shapes.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.cov(shapes.T))
    most = vectors[:, 2 - place.modes :] * np.sqrt(values[2 - place.modes :])
    spread = most @ most.T + HEIGHT**2 * np.outer(level, level) + SLOPE**2 * np.outer(slope, slope)
    values, vectors = np.linalg.eigh(spread)
    order = np.argsort(-values)[: place.modes]
    modes = (vectors * np.sqrt(np.maximum(values, 0) / (np.maximum(values, 0) + REST**2))).T[order]
    # The sign of a mode is arbitrary: it is fixed, so that every machine gives the same table.
    modes *= np.sign(modes[np.arange(place.modes), np.abs(modes).argmax(axis=1)])[:, None]
    return average, mean, modes


def table(bodies):
    """The text of girths.json."""
    row = lambda values: "[" + ", ".join(f"{value:.5f}" for value in values) + "]"
    places = []
    for place in PLACES:
        average, mean, modes = learn(bodies, place)
        measure = '"logarithm"' if place.logarithm else f'{{ "length": {average:.5f} }}'
        lines = [
            f'  "{place.name}": {{',
            f'    "first": {place.first},',
            f'    "measure": {measure},',
            f'    "mean": {row(mean)},',
            '    "modes": [',
            ",\n".join(f"      {row(mode)}" for mode in modes),
            "    ],",
            f'    "rest": {REST}',
            "  }",
        ]
        places.append("\n".join(lines))
    return "{\n" + ",\n".join(places) + "\n}\n"
