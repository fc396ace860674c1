"""Gradient boosting with the logistic loss (Friedman, Hastie and Tibshirani 2000): trees of depth three on bytes."""

import struct

import numba
import numpy as np

DEPTH, BINS, SHIFT = 3, 64, 2
LEAVES = 1 << DEPTH


@numba.njit(cache=True)
def histograms(columns, chosen, node, nodes, slope, bend):
    out = np.zeros((len(chosen), nodes, BINS, 2))
    for k in range(len(chosen)):
        column = columns[chosen[k]]
        for i in range(len(node)):
            at = out[k, node[i], column[i] >> SHIFT]
            at[0] += slope[i]
            at[1] += bend[i]
    return out


@numba.njit(cache=True)
def best_splits(sums, ridge):
    """For each node, the feature of its split, and the last bin whose rows go left."""
    features, nodes = sums.shape[0], sums.shape[1]
    which, bins, gains = np.zeros(nodes, np.int64), np.full(nodes, BINS - 1), np.full(nodes, 1e-9)
    for n in range(nodes):
        whole_g, whole_h = sums[0, n, :, 0].sum(), sums[0, n, :, 1].sum()
        for k in range(features):
            g = h = 0.0
            for b in range(BINS - 1):
                g += sums[k, n, b, 0]
                h += sums[k, n, b, 1]
                gain = g * g / (h + ridge) + (whole_g - g) ** 2 / (whole_h - h + ridge) - whole_g**2 / (whole_h + ridge)
                if gain > gains[n]:
                    which[n], bins[n], gains[n] = k, b, gain
    return which, bins


@numba.njit(cache=True)
def descend(columns, features, bins, node):
    for i in range(len(node)):
        n = node[i]
        node[i] = 2 * n + (1 if (columns[features[n], i] >> SHIFT) > bins[n] else 0)


def learn(rows, faces, weights, rounds, rate, ridge, tried, random, told=None):
    """The bias, and trees: 7 features (the root first), 7 thresholds (a larger byte goes right), 8 leaves."""
    columns = np.ascontiguousarray(rows.T)
    share = (weights * faces).sum() / weights.sum()
    bias = np.log(share / (1 - share))
    score = np.full(len(rows), bias)
    trees = []
    for turn in range(rounds):
        p = 1 / (1 + np.exp(-score))
        slope, bend = weights * (faces - p), weights * p * (1 - p)
        # Rows that are classified with certainty are left out of a round.
        heavy = np.flatnonzero(bend > 1e-3 * bend.max()) if turn else np.arange(len(rows))
        part = np.ascontiguousarray(columns[:, heavy]) if turn % 10 == 0 or turn < 3 else part
        heavy_now = heavy if turn % 10 == 0 or turn < 3 else heavy_now
        chosen = np.sort(random.choice(len(columns), tried, replace=False))
        node, asked, limits = np.zeros(len(heavy_now), np.int64), [], []
        for depth in range(DEPTH):
            sums = histograms(part, chosen, node, 1 << depth, slope[heavy_now], bend[heavy_now])
            which, bins = best_splits(sums, ridge)
            asked += chosen[which].tolist()
            limits += bins.tolist()
            descend(part, chosen[which], bins, node)
        leaves = rate * np.bincount(node, slope[heavy_now], LEAVES) / (np.bincount(node, bend[heavy_now], LEAVES) + ridge)
        trees.append((asked, [(b << SHIFT) + (1 << SHIFT) - 1 for b in limits], leaves))
        score += apply(columns, *trees[-1])
    return bias, trees


def apply(columns, asked, limits, leaves):
    return _apply(columns, np.array(asked), np.array(limits), np.array(leaves, float))


@numba.njit(cache=True)
def _apply(columns, asked, limits, leaves):
    out = np.zeros(columns.shape[1])
    for i in range(columns.shape[1]):
        n = 0
        for _ in range(DEPTH):
            n = 2 * n + (2 if columns[asked[n], i] > limits[n] else 1)
        out[i] = leaves[n - (LEAVES - 1)]
    return out


def scores(rows, bias, trees):
    columns = np.ascontiguousarray(rows.T)
    return bias + sum(apply(columns, *tree) for tree in trees)


def table(bias, trees):
    """The table for `subject/face/src/find/stages.rs`: the bias, then features, thresholds and leaves of each tree. Bias and leaves are in
    thousandths."""
    rows = [struct.pack("<7H7B8h", *map(int, asked), *map(int, limits), *(round(1000 * float(leaf)) for leaf in leaves))
            for asked, limits, leaves in trees]
    return struct.pack("<i", round(1000 * bias)) + b"".join(rows)
