"""C3D files for tests of archives: small, generated, each with other bytes."""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))

from c3d_files import c3d_file, channel_records, event_records  # noqa: E402

RATE_HZ = 100.0


def motion(seed, frames=120, markers=4):
    """Markers that swing; one of them is missing for ten frames."""
    random = np.random.default_rng(seed)
    time_s = np.arange(frames)[:, None, None] / RATE_HZ
    size = random.uniform(50, 300, (1, markers, 3))
    speed = random.uniform(1, 5, (1, markers, 3))
    points = 900 + size * np.sin(speed * time_s + random.uniform(0, 6, (1, markers, 3)))
    points += random.normal(0, 0.05, points.shape)
    points[20:30, 1] = np.nan
    return points.astype(np.float32)


def c3d(seed, frames=120, markers=4):
    points = motion(seed, frames, markers)
    return c3d_file(points, np.zeros((frames, 0)), 1, b"", rate_hz=RATE_HZ)


def limbs_c3d():
    """Markers on limbs, those of a limb far apart in the file, with analog channels, events and residuals."""
    row, marker, axis = np.ogrid[:150, :12, :3]
    limb, place, time = marker % 4, marker // 4, row / 20
    noise = (row * 7919 + marker * 104_729 + axis * 31) % 211
    swing = np.choose(axis, [np.sin(time + 0 * limb), np.cos(1.3 * time + limb), np.sin(0.7 * time * limb)])
    points = (swing * 90 * (limb + place) + noise / 50).astype(np.float32)
    points[40:50, 5] = np.nan
    records = channel_records(3) + event_records([0.5, 1.5], ["Left", "Right"], ["Foot Strike", "Foot Off"])
    analog = np.random.default_rng(3).normal(0, 1, (150 * 4, 3))
    residuals = (1 + (row + marker) % 3 + 0 * axis)[:, :, :1]
    return c3d_file(points, analog, 4, records, rate_hz=60.0, fourth_words=residuals)


def write_c3ds(folder, n, first_seed=0, **size):
    """Writes files in folders of subjects and sessions; returns the paths."""
    paths = []
    for number in range(n):
        path = Path(folder) / f"s{number % 3}" / f"day{number % 2}" / f"walk{number:04}.c3d"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(c3d(first_seed + number, **size))
        paths.append(path)
    return paths
