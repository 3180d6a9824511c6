"""Sobel gradients and the information that they hold (Shim et al. 2014; thesis eq. 3.2)."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from rig.vision.metrics.sampling import Places, bordered

SOBEL_MAX_SQUARED = 2 * (4 * 255) ** 2
"""The square of the largest Sobel gradient of an 8-bit picture."""

LAMBDA, DELTA = 1e3, 0.06
"""Steepness and threshold of the gradient information."""

_NORM = math.log(LAMBDA * (1 - DELTA) + 1)


def shim_gradient(grey: NDArray[np.uint8]) -> float:
    """Return the gradient information summed over every pixel of a grey picture.

    The border is mirrored without its last pixel, as OpenCV does.
    """
    picture, places = bordered(grey, cv2.BORDER_REFLECT_101)
    return float(gradient_information(squared_sobel(picture, *places)).sum(dtype=np.float64))


def gradient_sum(grey: NDArray[np.uint8]) -> float:
    """Return the plain sum of the same gradients, each 0..1, before they become information."""
    picture, places = bordered(grey, cv2.BORDER_REFLECT_101)
    magnitudes = np.sqrt(squared_sobel(picture, *places) / SOBEL_MAX_SQUARED)
    return float(magnitudes.sum())


def sampled_information(grey: NDArray[np.uint8], places: Places) -> float:
    """Return the mean gradient information at some inner places of a picture, 0..1."""
    return float(gradient_information(squared_sobel(grey, *places)).mean(dtype=np.float64))


@njit(cache=True, nogil=True)
def squared_sobel(
    grey: NDArray[np.uint8], rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> NDArray[np.int32]:
    """Return the squared Sobel gradients where `rows` and `columns`, all inner, cross."""
    squared = np.empty((len(rows), len(columns)), np.int32)
    for i in range(len(rows)):
        y = rows[i]
        above, here, below = grey[y - 1], grey[y], grey[y + 1]
        for j in range(len(columns)):
            x = columns[j]
            a, b, c = np.int32(above[x - 1]), np.int32(above[x]), np.int32(above[x + 1])
            d, f = np.int32(here[x - 1]), np.int32(here[x + 1])
            g, h, k = np.int32(below[x - 1]), np.int32(below[x]), np.int32(below[x + 1])
            across = c - a + 2 * (f - d) + k - g
            down = g - a + 2 * (h - b) + k - c
            squared[i, j] = across * across + down * down
    return squared


@njit(cache=True, nogil=True)
def gradient_information(squared: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return the information of squared Sobel gradients, each 0..1 (thesis eq. 3.2)."""
    information = np.zeros(squared.shape, np.float32)
    scale, steepness = np.float32(1 / math.sqrt(SOBEL_MAX_SQUARED)), np.float32(LAMBDA)
    share, delta = np.float32(1 / _NORM), np.float32(DELTA)
    least = np.int32(DELTA * DELTA * SOBEL_MAX_SQUARED)
    for row in range(squared.shape[0]):
        for column in range(squared.shape[1]):
            if squared[row, column] > least:
                excess = scale * math.sqrt(np.float32(squared[row, column])) - delta
                information[row, column] = share * math.log(steepness * excess + np.float32(1))
    return information
