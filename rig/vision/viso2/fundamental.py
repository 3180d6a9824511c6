"""The epipolar geometry of matches: the eight-point algorithm inside RANSAC."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rig.vision.viso2.symmetric import weakest_direction

TRIALS = 2000
SAMPLE = 8

SAMPSON_MAX = 1e-5
"""The largest Sampson distance of an inlier, in normalised coordinates squared."""

MATCHES_MIN = 10
"""Fewer matches, or fewer inliers, tell no motion."""

_CHUNK = 256

Points = NDArray[np.float64]


def normalise(points_px: NDArray[Any]) -> tuple[Points, Points]:
    """Return N x 2 points with mean 0 and mean distance sqrt(2), and the 3 x 3 that did it.

    (Hartley, PAMI 1997.) Points that are all one have no such scale and keep theirs.
    """
    points = np.asarray(points_px, np.float64)
    centre = points.mean(axis=0)
    distance = float(np.hypot(*(points - centre).T).mean())
    scale = np.sqrt(2) / distance if distance > 0 else 1.0
    transform = np.array(
        [[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]]
    )
    return (points - centre) * scale, transform


def inliers(previous_px: NDArray[Any], current_px: NDArray[Any], seed: int) -> NDArray[np.bool_]:
    """Return which of N matches (N x 2 points each) fit the geometry that most of them fit.

    The best of 2000 eight-point solutions; the same seed draws the same samples. Fewer than 10
    matches, or fewer than 10 inliers, have none.
    """
    count = len(current_px)
    nothing = np.zeros(count, np.bool_)
    if count < MATCHES_MIN:
        return nothing
    (previous, _), (current, _) = normalise(previous_px), normalise(current_px)
    rng = np.random.default_rng(seed)
    samples = _samples(rng.random((TRIALS, SAMPLE)), count)
    mixed = rng.permutation(count)
    rows = np.concatenate([previous, current], axis=1)
    best = _best_model(rows, rows[mixed].T.copy(), samples)
    if best is None:
        return nothing
    mask = np.asarray(_fits(best, rows.T.copy()))
    return mask if mask.sum() >= MATCHES_MIN else nothing


def fundamental(previous_px: NDArray[Any], current_px: NDArray[Any]) -> Points:
    """Return F with current' F previous = 0, least squares over N >= 8 matches, of rank 2."""
    previous, from_previous = normalise(previous_px)
    current, from_current = normalise(current_px)
    rows = _equations(previous, current)
    _, vectors = np.linalg.eigh(rows.T @ rows)
    u, s, vt = np.linalg.svd(vectors[:, 0].reshape(3, 3))
    normalised = (u[:, :2] * s[:2]) @ vt[:2]
    return np.asarray(from_current.T @ normalised @ from_previous)


def _equations(previous: Points, current: Points) -> Points:
    x, y = previous.T
    u, v = current.T
    return np.stack([u * x, u * y, u, v * x, v * y, v, x, y, np.ones_like(x)], axis=1)


@njit(cache=True, nogil=True)
def _samples(draws: Points, count: int) -> NDArray[np.int64]:
    """Return for each row of draws in [0, 1) as many different numbers below `count` (Floyd)."""
    trials, size = draws.shape
    samples = np.empty((trials, size), np.int64)
    for trial in range(trials):
        for k in range(size):
            last = count - size + k
            chosen = int(draws[trial, k] * (last + 1))
            for earlier in range(k):
                if samples[trial, earlier] == chosen:
                    chosen = last
            samples[trial, k] = chosen
    return samples


@njit(cache=True, nogil=True)
def _best_model(rows: Points, mixed: Points, samples: NDArray[np.int64]) -> Any:
    """Return the F, 3 x 3, of the sample that the most matches fit; the first of equals.

    A sample is given up once it can no longer beat the best: that changes no result.
    `mixed` holds the matches in random order, 4 x N.
    """
    total = mixed.shape[1]
    most = 0
    best = None
    for trial in range(len(samples)):
        model = _eight_point(rows, samples[trial])
        count = 0
        for start in range(0, total, _CHUNK):
            stop = min(start + _CHUNK, total)
            count += _count_fits(model, mixed, start, stop)
            if count + total - stop <= most:
                break
        if count > most:
            most = count
            best = model
    return best


@njit(cache=True, nogil=True)
def _eight_point(rows: Points, sample: NDArray[np.int64]) -> Points:
    """Return the rank-2 F through eight matches, the null vector of their equations."""
    a = np.empty((SAMPLE, 9))
    for k in range(SAMPLE):
        x, y, u, v = rows[sample[k]]
        a[k] = np.array([u * x, u * y, u, v * x, v * y, v, x, y, 1.0])
    model = _null_vector(a).reshape(3, 3)
    weakest = weakest_direction(model.T @ model)
    for i in range(3):
        along = model[i, 0] * weakest[0] + model[i, 1] * weakest[1] + model[i, 2] * weakest[2]
        for j in range(3):
            model[i, j] -= along * weakest[j]
    return model


@njit(cache=True, nogil=True)
def _null_vector(a: Points) -> Points:
    """Return the unit vector that an 8 x 9 matrix sends to 0: elimination, full pivoting."""
    unknowns = np.arange(9)
    for step in range(SAMPLE):
        row, column, largest = step, step, -1.0
        for i in range(step, SAMPLE):
            for j in range(step, 9):
                if abs(a[i, j]) > largest:
                    row, column, largest = i, j, abs(a[i, j])
        if largest < 1e-12:
            break
        for j in range(9):
            a[step, j], a[row, j] = a[row, j], a[step, j]
        for i in range(SAMPLE):
            a[i, step], a[i, column] = a[i, column], a[i, step]
        unknowns[step], unknowns[column] = unknowns[column], unknowns[step]
        for i in range(step + 1, SAMPLE):
            factor = a[i, step] / a[step, step]
            for j in range(step, 9):
                a[i, j] -= factor * a[step, j]
    solution = np.zeros(9)
    solution[8] = 1.0
    for i in range(SAMPLE - 1, -1, -1):
        if abs(a[i, i]) < 1e-12:
            continue
        total = 0.0
        for j in range(i + 1, 9):
            total += a[i, j] * solution[j]
        solution[i] = -total / a[i, i]
    vector = np.empty(9)
    vector[unknowns] = solution
    vector /= np.sqrt((vector * vector).sum())
    return vector


@njit(cache=True, nogil=True)
def _fits(model: Points, matches: Points) -> NDArray[np.bool_]:
    mask = np.empty(matches.shape[1], np.bool_)
    for i in range(matches.shape[1]):
        mask[i] = _count_fits(model, matches, i, i + 1) == 1
    return mask


@njit(cache=True, nogil=True)
def _count_fits(model: Points, matches: Points, start: int, stop: int) -> int:
    """Return how many of the matches start..stop have a small enough Sampson distance."""
    f00, f01, f02 = model[0]
    f10, f11, f12 = model[1]
    f20, f21, f22 = model[2]
    count = 0
    for i in range(start, stop):
        x, y, u, v = matches[0, i], matches[1, i], matches[2, i], matches[3, i]
        line_x = f00 * x + f01 * y + f02
        line_y = f10 * x + f11 * y + f12
        back_x = f00 * u + f10 * v + f20
        back_y = f01 * u + f11 * v + f21
        miss = u * line_x + v * line_y + f20 * x + f21 * y + f22
        slope = line_x * line_x + line_y * line_y + back_x * back_x + back_y * back_y
        count += miss * miss < SAMPSON_MAX * slope
    return count
