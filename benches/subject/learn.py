"""Trains the regression from landmarks to joints, subject/body/data/joint-weights.json, after the girth models of knee, elbow
and wrist (girth.py), on which the landmarks depend.

    MOCAPD_BODIES=... python3 benches/subject/learn.py

A joint is a weighted mean of landmarks (subject/body/src/locate/landmark.rs). The weights sum to one, so that the joint
moves, rotates and scales with the body. They come from a ridge regression on the shapes mavg and favg alone, and are the
same for the left and the right side.

Printed for each joint: mean and 95th percentile of the error, in per cent of stature, with each shape left out in turn, with
each pose left out, and with each build left out. The written standard deviation is sigma() of these errors. Needs numpy.
"""

import json
import pathlib
import subprocess

import numpy as np

import girth

PROJECT = pathlib.Path(__file__).resolve().parents[2]
WEIGHTS = PROJECT / "subject/body/data/joint-weights.json"
GIRTHS = PROJECT / "subject/body/data/girths.json"
SHAPES = ["mh_mavg", "mh_favg"]

# Joint, its name in the ground truth (with .L and .R if there are two), ridge, and landmarks: part, first, one past the last.
# The ridge is in body scales squared: a weight of 1 costs as much as an error of its square root.
JOINTS = [
    ("head", "head_top", 1e-3, [("head", 0, 7)]),
    ("throat", "neck", 3e-3, [("head", 3, 13), ("arm", 16, 22), ("other_arm", 16, 22)]),
    ("shoulder", "shoulder", 3e-3, [("arm", 10, 22), ("other_arm", 16, 22), ("leg", 23, 28), ("other_leg", 23, 28), ("head", 3, 13)]),
    ("elbow", "elbow", 1e-3, [("arm", 5, 16)]),
    ("wrist", "wrist", 1e-4, [("arm", 0, 8)]),
    ("hip", "hip", 1e-3, [("leg", 16, 28), ("other_leg", 16, 28), ("arm", 16, 22), ("other_arm", 16, 22), ("head", 3, 13)]),
    ("knee", "knee", 1e-3, [("leg", 8, 18)]),
    ("ankle", "ankle", 3e-4, [("leg", 0, 10)]),
]


def landmarks():
    command = ["cargo", "run", "--release", "-q", "-p", "mocapd-body", "--example", "body_landmarks", "--", *SHAPES]
    lines = subprocess.run(command, cwd=PROJECT, check=True, capture_output=True, text=True).stdout.splitlines()
    return [json.loads(line) for line in lines]


def samples(bodies, truth, spans):
    """For each body and side: landmarks and joint in body scales, shape, pose, build, stature over scale."""
    for body in bodies:
        joints = {name: np.array(at) / body["scale"] for name, at in body["joints"].items()}
        wrist = np.array(body["halves"][0]["arm"][4])
        first = min("LR", key=lambda side: np.linalg.norm(wrist - joints[f"wrist.{side}"]))
        for half, side in ((0, first), (1, "LR".replace(first, ""))):
            own, other = body["halves"][half], body["halves"][1 - half]
            parts = {"arm": own["arm"], "other_arm": other["arm"], "leg": own["leg"], "other_leg": other["leg"], "head": body["head"]}
            points = np.concatenate([parts[part][start:end] for part, start, end in spans])
            target = joints.get(truth, joints.get(f"{truth}.{side}"))
            words = body["name"].split("_")
            yield points, target, words[1], words[2], body["build"], body["stature"] / body["scale"]


def fit(points, targets, ridge, weights):
    """Weights of landmarks that sum to one, regularised towards the one landmark that is closest on average."""
    distances = np.linalg.norm(points - targets[:, None], axis=2)
    nearest = int(np.argmin(distances.mean(axis=0)))
    relative = points - points[:, nearest : nearest + 1]
    total = weights.sum()
    gram = np.einsum("n,nkc,nlc->kl", weights, relative, relative) / total
    right = np.einsum("n,nkc,nc->k", weights, relative, targets - points[:, nearest]) / total
    found = np.linalg.solve(gram + ridge * np.eye(len(gram)), right)
    found[nearest] = 0
    found[nearest] = 1 - found.sum()
    return found


def errors(points, targets, found):
    return np.linalg.norm(np.einsum("nkc,k->nc", points, found) - targets, axis=1)


def left_out(points, targets, ridge, groups, weights):
    found = np.zeros(len(targets))
    for group in np.unique(groups):
        out = groups == group
        found[out] = errors(points[out], targets[out], fit(points[~out], targets[~out], ridge, weights[~out]))
    return found


def learn(bodies, truth, ridge, spans):
    points, targets, shapes, poses, builds, statures = map(np.array, zip(*samples(bodies, truth, spans)))
    # Each combination of shape, pose and build has the same weight, however many variants it has.
    key = np.array([f"{shape} {pose} {build}" for shape, pose, build in zip(shapes, poses, builds)])
    names, inverse, counts = np.unique(key, return_inverse=True, return_counts=True)
    weights = 1 / counts[inverse]
    by_shape = left_out(points, targets, ridge, shapes, weights)
    by_pose = left_out(points, targets, ridge, poses, weights)
    by_build = left_out(points, targets, ridge, builds, weights)
    left = [by_shape / statures, by_pose / statures, by_build / statures]
    return fit(points, targets, ridge, weights), sigma(by_shape, by_pose), left


# Two shapes give a single difference between people. The ratio of the median of its square to the mean over many pairs:
# the median of chi-squared with one degree of freedom.
ONE_DIFFERENCE = 0.455
# The bones of people of equal stature vary by about 4 %, which is 0.01 stature for the longest. About half of this is assumed
# to be visible on the surface.
UNSEEN = 0.005


def sigma(by_shape, by_pose):
    """The expected standard deviation on a new body: within a shape, between shapes, and invisible on the surface."""
    within = np.mean(by_pose**2)
    between = max(np.mean(by_shape**2) - within, 0) / ONE_DIFFERENCE
    return np.sqrt(within + between + UNSEEN**2)


def entry(name, spans, found, sigma):
    """The text of a joint in the table."""
    lines = []
    at = 0
    for part, start, end in spans:
        weights = ", ".join(f"{weight:.5f}" for weight in found[at : at + end - start])
        at += end - start
        lines.append(f'    {{ "part": "{part}", "first": {start}, "weights": [{weights}] }}')
    return f'  "{name}": {{ "sigma": {sigma:.4f}, "spans": [\n' + ",\n".join(lines) + "\n  ] }"


# Bone, and its ends in the ground truth.
BONES = [("upper_arm", "shoulder", "elbow"), ("thigh", "hip", "knee")]


def bones(bodies):
    """Mean lengths in body scales, with equal weight for each shape."""
    for name, near, far in BONES:
        lengths = {}
        for body in bodies:
            at = {joint: np.array(position) / body["scale"] for joint, position in body["joints"].items()}
            for side in "LR":
                shape = body["name"].split("_")[1]
                lengths.setdefault(shape, []).append(np.linalg.norm(at[f"{near}.{side}"] - at[f"{far}.{side}"]))
        yield name, np.mean([np.mean(of_shape) for of_shape in lengths.values()])


def main():
    GIRTHS.write_text(girth.table(landmarks()))
    bodies = landmarks()
    entries = []
    print(f"{len(bodies)} meshes\n| joint | shape left out: mean / p95, %st | pose left out | build left out |\n|---|---|---|---|")
    for name, truth, ridge, spans in JOINTS:
        found, sigma, left = learn(bodies, truth, ridge, spans)
        cells = [f"{np.mean(e) * 100:.2f} / {np.percentile(e, 95) * 100:.2f}" for e in left]
        print(f"| {name} | {' | '.join(cells)} |")
        # Rounded weights must still sum to one: the remainder is added to the largest.
        found = np.round(found, 5)
        found[np.argmax(np.abs(found))] += 1 - found.sum()
        entries.append(entry(name, spans, found, sigma))
    for name, length in bones(bodies):
        entries.append(f'  "{name}": {length:.4f}')
    WEIGHTS.write_text("{\n" + ",\n".join(entries) + "\n}\n")


main()
