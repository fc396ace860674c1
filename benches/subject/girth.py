"""How thick a leg is round the knee: learns the mean and the ways in which legs differ, and writes
subject/src/body/locate/girth_weights.rs. Part of learn.py."""

import numpy as np

STEP = 0.006  # section.rs
FIRST, EVERY, PLACES, MODES = -0.12, 2 * STEP, 23, 6  # girth.rs
# Of the standard deviations of a whole profile's height and slope: more than any person's, so that they say nothing.
HEIGHT, SLOPE = 0.5, 0.3
# So much is left to chance at each place, in the logarithm of the girth.
REST = 0.04


def level_nearest(line, at):
    """Where the centre line (levels x 3) passes nearest to a joint, as a level; looked for on the middle of the leg."""
    levels = (np.arange(len(line)) + 1) * STEP
    distances = np.where((levels > 0.2) & (levels < 0.48), np.linalg.norm(line - at, axis=1), np.inf)
    best = int(np.argmin(distances))
    along = line[best + 1] - line[best - 1]
    return levels[best] + np.clip((at - line[best]) @ along / (along @ along) * 2, -1, 1) * STEP


def profiles(bodies):
    """Logarithms of the girth round each true knee."""
    for body in bodies:
        for half in body["halves"]:
            line, length = np.array(half["leg_line"]), np.array(half["leg_girth"])
            knees = [np.array(body["joints"][f"knee.{side}"]) / body["scale"] for side in "LR"]
            knee = min(knees, key=lambda knee: np.linalg.norm(line - knee, axis=1)[40:75].min())
            at = level_nearest(line, knee) + FIRST + EVERY * np.arange(PLACES)
            yield np.log(np.interp(at, (np.arange(len(length)) + 1) * STEP, length))


def learn(bodies):
    """The mean profile, and the modes scaled as girth.rs takes them: probabilistic principal components (Tipping and Bishop
    1999), with height and slope of the profile left free."""
    found = np.array(list(profiles(bodies)))
    mean = found.mean(axis=0)
    level = np.ones(PLACES)
    slope = np.arange(PLACES) - (PLACES - 1) / 2
    slope /= slope.std()
    shapes = found - mean
    shapes -= shapes.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.cov(shapes.T))
    most = vectors[:, 2 - MODES :] * np.sqrt(values[2 - MODES :])
    spread = most @ most.T + HEIGHT**2 * np.outer(level, level) + SLOPE**2 * np.outer(slope, slope)
    values, vectors = np.linalg.eigh(spread)
    order = np.argsort(-values)[:MODES]
    modes = (vectors * np.sqrt(np.maximum(values, 0) / (np.maximum(values, 0) + REST**2))).T[order]
    # Which way a mode points is nothing: the same on every machine.
    modes *= np.sign(modes[np.arange(MODES), np.abs(modes).argmax(axis=1)])[:, None]
    return mean, modes


def rust(mean, modes):
    row = lambda values: ", ".join(f"{value:.5f}" for value in values)
    return "\n".join(
        [
            "//! Written by `benches/subject/learn.py` from the shapes mavg and favg: change it there.",
            "",
            "use super::girth::Girth;",
            "",
            "pub(super) static KNEE: Girth = Girth {",
            f"    mean: [{row(mean)}],",
            "    modes: [",
            *(f"        [{row(mode)}]," for mode in modes),
            "    ],",
            f"    rest: {REST},",
            "};",
            "",
        ]
    )
