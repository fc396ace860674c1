"""Adaptive asynchronous resampling with natural cubic splines (Shi et al. 2012, doi
10.3969/j.issn.0372-2112.2012.01.021, section 2.3), written from the paper in float64.

Each run between gaps is resampled on its own. Its first and last samples are kept; then one sample after another
is added until the spline through the kept ones is within the tolerance at every sample. Which one is added:

- worst_sample: where the error is largest;
- exhaustive: the one whose addition leaves the smallest sum of squared errors.

The lowest index wins ties.
"""

import numpy as np
from scipy.linalg import solveh_banded


def second_derivatives(times, values):
    """Of the natural cubic spline: a tridiagonal system, symmetric and diagonally dominant."""
    n = len(times)
    if n < 3:
        return np.zeros_like(values)
    steps = np.diff(times)
    slopes = np.diff(values, axis=0) / steps[:, None]
    diagonal, right = 2.0 * (steps[:-1] + steps[1:]), 6.0 * np.diff(slopes, axis=0)
    beside = np.append(steps[1:-1], 0.0)
    inner = right / diagonal if n == 3 else solveh_banded([diagonal, beside], right, lower=True, check_finite=False)
    return np.pad(inner, ((1, 1), (0, 0)))


def evaluate(times, values, curvature, at):
    """The spline at the times `at`."""
    left = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    step = (times[left + 1] - times[left])[:, None]
    b = (at - times[left])[:, None] / step
    a = 1.0 - b
    cubic = ((a**3 - a) * curvature[left] + (b**3 - b) * curvature[left + 1]) * step**2 / 6.0
    return a * values[left] + b * values[left + 1] + cubic


def squared_errors(samples, kept):
    """Squared distance of every sample of a run to the spline through the kept ones."""
    at = np.arange(len(samples), dtype=np.float64)
    times, values = at[kept], samples[kept]
    found = evaluate(times, values, second_derivatives(times, values), at)
    return ((found - samples) ** 2).sum(axis=1)


def candidate_errors(samples, kept, candidates):
    """Squared distances of all samples, one row for each candidate added to the kept ones: dense solves at once."""
    n_samples, n_candidates = len(samples), len(candidates)
    at = np.arange(n_samples, dtype=np.float64)
    knots = np.sort(np.hstack([np.tile(kept, (n_candidates, 1)), candidates[:, None]]), axis=1)
    times, values = at[knots], samples[knots]
    n_knots = knots.shape[1]
    steps = np.diff(times, axis=1)
    slopes = np.diff(values, axis=1) / steps[:, :, None]
    matrix = np.zeros((n_candidates, n_knots - 2, n_knots - 2))
    inner = np.arange(n_knots - 2)
    matrix[:, inner, inner] = 2.0 * (steps[:, :-1] + steps[:, 1:])
    matrix[:, inner[:-1], inner[1:]] = matrix[:, inner[1:], inner[:-1]] = steps[:, 1:-1]
    curvature = np.zeros_like(values)
    curvature[:, 1:-1] = np.linalg.solve(matrix, 6.0 * np.diff(slopes, axis=1))
    errors = np.empty((n_candidates, n_samples))
    for row in range(n_candidates):
        found = evaluate(times[row], values[row], curvature[row], at)
        errors[row] = ((found - samples) ** 2).sum(axis=1)
    return errors


def resample_run(samples, tolerances, exhaustive):
    """Kept indices of a run for each tolerance: the samples are added in the same order for all of them."""
    samples = samples.astype(np.float64)
    n_samples = len(samples)
    kept = np.unique([0, n_samples - 1])
    results = {}
    for tolerance in sorted(tolerances, reverse=True):
        while len(kept) < n_samples:
            errors = squared_errors(samples, kept)
            errors[kept] = 0.0
            if np.sqrt(errors.max()) <= tolerance:
                break
            if exhaustive:
                candidates = np.setdiff1d(np.arange(n_samples), kept)
                sums = candidate_errors(samples, kept, candidates).sum(axis=1)
                added = candidates[np.argmin(sums)]
            else:
                added = np.argmax(errors)
            kept = np.sort(np.append(kept, added))
        results[tolerance] = kept
    return results


def resample(positions, tolerances, exhaustive=False):
    """Kept frame numbers of one channel, (frames, 3) with NaN where missing, for each tolerance."""
    present = ~np.isnan(positions[:, 0])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], present, [0]])))
    kept = {tolerance: [np.empty(0, int)] for tolerance in tolerances}
    for start, end in edges.reshape(-1, 2):
        for tolerance, indices in resample_run(positions[start:end], tolerances, exhaustive).items():
            kept[tolerance].append(start + indices)
    return {tolerance: np.concatenate(runs) for tolerance, runs in kept.items()}


def storage_ratios(positions, kept):
    """SR1 and SR2, equations (7) and (8), counted over the samples present; `kept` is one list for each channel."""
    present = ~np.isnan(positions[:, :, 0])
    n_stored = present.sum() + present.any(axis=1).sum()
    union = np.unique(np.concatenate(kept)) if kept else np.empty(0, int)
    synchronous = present[union].sum() + len(union)
    asynchronous = 2 * sum(len(times) for times in kept)
    return n_stored / synchronous, n_stored / asynchronous
