"""Percentiles of the gradient (Zhang et al. 2017; thesis eq. 3.4 and 3.5).

The gradient of a pixel is the squared length of its Scharr gradient over 32, in grey levels
squared, with OpenCV's mirrored border: the definitions of the authors' code.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

SCHARR_SUM = 32
PIVOT, ORDER = 0.7, 5.0
"""The authors' percentile p and exponent k."""


def zhang_percentile(grey: NDArray[np.uint8], pivot: float = PIVOT) -> float:
    """Return the gradient that the share `pivot` of all pixels does not reach."""
    gradients = scharr_squared(grey).ravel()
    rank = math.floor(pivot * gradients.size)
    return float(np.partition(gradients, rank)[rank])


def zhang_soft(grey: NDArray[np.uint8], pivot: float = PIVOT, order: float = ORDER) -> float:
    """Return the mean of the sorted gradients, weighted by a sine that peaks at `pivot`."""
    gradients = np.sort(scharr_squared(grey), axis=None)
    return float(gradients @ sine_weights(gradients.size, pivot, order))


def scharr(picture: NDArray[np.uint8] | NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
    """Return the Scharr gradients across and down, over 32, H x W each."""
    across = cv2.Scharr(picture, cv2.CV_32F, 1, 0, scale=1 / SCHARR_SUM)
    down = cv2.Scharr(picture, cv2.CV_32F, 0, 1, scale=1 / SCHARR_SUM)
    return np.asarray(across, np.float32), np.asarray(down, np.float32)


def scharr_squared(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the squared gradients, H x W, in grey levels squared."""
    across, down = scharr(grey)
    return across * across + down * down


def sine_weights(count: int, pivot: float = PIVOT, order: float = ORDER) -> NDArray[np.float64]:
    """Return the weights of `count` sorted values; their sum is 1.

    They rise as sin^k to 1 at the pivot and fall to 0 at the end: the second branch of thesis
    eq. 3.5 counts from the pivot, which its print forgets.
    """
    first = max(int(count * pivot), 1)
    second = count - first
    rising = np.sin(np.arange(first) * (math.pi / 2 / max(first - 1, 1)))
    rising[-1] = 1.0
    falling = np.cos(np.arange(1, second + 1) * (math.pi / 2 / max(second, 1)))
    weights = np.concatenate([rising, np.maximum(falling, 0.0)]) ** order
    return np.asarray(weights / weights.sum())
