"""What the grey levels of a picture tell, wherever they lie: mean and entropy."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray


def mean_dn(image: NDArray[np.uint8]) -> float:
    """Return the mean grey of a grey picture or a mosaic, 0..255."""
    mean = float(cv2.mean(image)[0])
    return min(mean, 255.0)  # OpenCV's sum times 1/n may end a bit above a white picture's 255


def entropy_bits(grey: NDArray[np.uint8]) -> float:
    """Return the Shannon entropy of the grey levels, 0..8 bits (thesis eq. 3.1, one channel)."""
    counts = histogram(grey)
    shares = counts[counts > 0] / grey.size
    return float(-(shares * np.log2(shares)).sum()) + 0.0


def geometric_mean_dn(grey: NDArray[np.uint8]) -> float:
    """Return the geometric mean of the grey levels, 1..255; black counts as 1."""
    logarithms = np.log(np.maximum(np.arange(256), 1))
    return float(np.exp(histogram(grey) @ logarithms / grey.size))


@njit(cache=True, nogil=True)
def histogram(grey: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the number of pixels of each of the 256 grey levels."""
    counts = np.zeros(256, np.int64)
    for row in range(grey.shape[0]):
        for column in range(grey.shape[1]):
            counts[grey[row, column]] += 1
    return counts
