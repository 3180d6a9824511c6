"""A Gaussian process over a grid, and where to look next (Kim et al. 2018 and 2020)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]


class Belief(NamedTuple):
    """Mean and variance at N candidates."""

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]


def posterior(
    points: Points, values: NDArray[np.float64], candidates: Points, length: float, noise: float
) -> Belief:
    """Return what `values` at `points` (M x D) say of `candidates` (N x D).

    Squared-exponential kernel of variance 1 and one `length`, observation noise of standard
    deviation `noise` > 0, prior mean 0.
    """
    among = _kernel(points, points, length) + noise**2 * np.eye(len(points))
    across = _kernel(points, candidates, length)
    solved = np.linalg.solve(among, np.column_stack([values, across]))
    mean = across.T @ solved[:, 0]
    explained = np.einsum("ij,ij->j", across, solved[:, 1:])
    return Belief(mean, np.maximum(1 - explained, 0.0))


def maxmi(belief: Belief, alpha: float, psi: float) -> NDArray[np.float64]:
    """Return the acquisition of every candidate: its mean, and what looking there would teach.

    mean + sqrt(alpha) (sqrt(variance^2 + psi) - sqrt(psi)), the form of the authors' programs;
    `psi` is the sum of the variances at the places chosen before.
    """
    learnt = np.sqrt(belief.variance**2 + psi) - np.sqrt(psi)
    return np.asarray(belief.mean + np.sqrt(alpha) * learnt)


def squared_distances(a: Points, b: Points) -> NDArray[np.float64]:
    """Return the squared distances of M x D points to N x D ones, M x N."""
    total = np.zeros((len(a), len(b)))
    for axis in range(a.shape[1]):
        total += np.subtract.outer(a[:, axis], b[:, axis]) ** 2
    return total


def _kernel(a: Points, b: Points, length: float) -> NDArray[np.float64]:
    return np.asarray(np.exp(-0.5 * squared_distances(a, b) / length**2))
