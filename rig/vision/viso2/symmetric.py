"""The weakest direction of a small symmetric matrix."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

SWEEPS = 10
"""Jacobi's rotations converge quadratically; 4 x 4 needs about five sweeps."""


@njit(cache=True, nogil=True)
def weakest_direction(symmetric: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit eigenvector of the least eigenvalue of an n x n; overwrites the matrix.

    Jacobi's method: for matrices this small it is far quicker than a library call.
    """
    size = len(symmetric)
    turned = np.eye(size)
    scale = np.trace(symmetric)
    for _ in range(SWEEPS):
        off = 0.0
        for p in range(size - 1):
            for q in range(p + 1, size):
                off += symmetric[p, q] * symmetric[p, q]
        if off <= 1e-32 * scale * scale:
            break
        for p in range(size - 1):
            for q in range(p + 1, size):
                if symmetric[p, q] != 0.0:
                    _rotate(symmetric, turned, p, q)
    weakest = 0
    for k in range(1, size):
        if symmetric[k, k] < symmetric[weakest, weakest]:
            weakest = k
    return turned[:, weakest].copy()


@njit(cache=True, nogil=True)
def _rotate(symmetric: NDArray[np.float64], turned: NDArray[np.float64], p: int, q: int) -> None:
    """Turn the axes p and q so that their product in the matrix becomes 0."""
    theta = (symmetric[q, q] - symmetric[p, p]) / (2.0 * symmetric[p, q])
    sign = 1.0 if theta >= 0 else -1.0
    tangent = sign / (abs(theta) + np.sqrt(theta * theta + 1.0))
    cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    for k in range(len(symmetric)):
        a, b = symmetric[k, p], symmetric[k, q]
        symmetric[k, p], symmetric[k, q] = cosine * a - sine * b, sine * a + cosine * b
    for k in range(len(symmetric)):
        a, b = symmetric[p, k], symmetric[q, k]
        symmetric[p, k], symmetric[q, k] = cosine * a - sine * b, sine * a + cosine * b
        a, b = turned[k, p], turned[k, q]
        turned[k, p], turned[k, q] = cosine * a - sine * b, sine * a + cosine * b
