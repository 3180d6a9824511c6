"""Gradients that count, less saturation (Kim et al. 2018, 2020), as the authors' C++ code has it.

score = sum of the gradients above 0.3 of their mean - 5 x mean x number of saturated pixels, in a
picture of 320 x 240. A pixel is saturated when its local entropy is the picture's least.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

SIZE_PX = (320, 240)
NEIGHBOURS_PX = 5
STRONG_SHARE = 0.3
SATURATED_ENTROPY = 0.001
PENALTY = 5.0
GRADIENT_GAIN = 1.49999


def kim(grey: NDArray[np.uint8]) -> float:
    """Return the score of a grey picture of any size."""
    return kim_small(shrunk(grey))


def shrunk(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the 320 x 240 picture, by bilinear samples, in which the score is measured."""
    return np.asarray(cv2.resize(grey, SIZE_PX, interpolation=cv2.INTER_LINEAR), np.uint8)


def kim_small(grey: NDArray[np.uint8]) -> float:
    """Return the score of a picture as it is."""
    gradient = _gradient(grey)
    mean = float(gradient.mean(dtype=np.float64))
    strong = float(gradient[gradient > STRONG_SHARE * mean].sum(dtype=np.float64))
    saturated = int(np.count_nonzero(local_entropy(grey) <= SATURATED_ENTROPY))
    return strong - PENALTY * mean * saturated


def _gradient(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the sum of the rising central differences, 0..1.

    The code computes them in 8 bits, where a falling edge is 0, and saturates the sum. Its border
    is mirrored, so a difference across it is 0.
    """
    across, down = np.zeros_like(grey), np.zeros_like(grey)
    across[:, 1:-1] = cv2.subtract(grey[:, 2:], grey[:, :-2])
    down[1:-1] = cv2.subtract(grey[2:], grey[:-2])
    both = cv2.addWeighted(across, GRADIENT_GAIN, down, GRADIENT_GAIN, 0)
    return np.asarray(both, np.float32) * np.float32(1 / 255)


def local_entropy(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the entropy of the 5 x 5 neighbours of each pixel, stretched to 0..1, H x W.

    Three peculiarities of the code are kept, for they move the score: shares are counts over 5,
    not over 25; the neighbours are those two columns to the left; and the last two rows and
    columns are not computed, but stay where an entropy of 0 lies.
    """
    edge = NEIGHBOURS_PX // 2
    wider = cv2.copyMakeBorder(grey, edge, edge, edge, edge, cv2.BORDER_REPLICATE)
    shares = np.arange(NEIGHBOURS_PX**2 + 1) / NEIGHBOURS_PX
    table = np.zeros(len(shares))
    table[1:] = shares[1:] * np.log2(shares[1:])
    before = np.zeros(2 * edge, np.uint8)  # what the code reads there is before its array
    flat = np.concatenate([before, np.asarray(wider, np.uint8).ravel()])
    entropy = _entropies(flat, grey.shape[0], grey.shape[1], np.diff(table))
    low, high = float(entropy.min()), float(entropy.max())
    return np.asarray((entropy - low) / (high - low if high > low else 1.0), np.float32)


@njit(cache=True, nogil=True)
def _entropies(
    flat: NDArray[np.uint8], height: int, width: int, steps: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the entropies from the flat, widened picture, where a row runs on into the next.

    The window slides along a row: one column of five leaves it before one enters, so that no count
    is ever above 25. `steps` is by how much the sum grows when a count does.
    """
    entropy = np.zeros((height, width))
    stride = width + 4
    counts = np.zeros(256, np.int32)
    for y in range(height - 2):
        counts[:] = 0
        total = 0.0
        first = y * stride + 2
        for column in range(-5, width - 2):
            if column > -1:
                for k in range(5):
                    leaving = flat[first + k * stride + column - 1]
                    counts[leaving] -= 1
                    total += steps[counts[leaving]]
            for k in range(5):
                entering = flat[first + k * stride + column + 4]
                total -= steps[counts[entering]]
                counts[entering] += 1
            if column >= 0:
                entropy[y, column] = total
    return entropy
