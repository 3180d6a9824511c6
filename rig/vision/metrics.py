"""Scores of one picture, by which exposure methods of the literature judge it.

All look at 8-bit pictures: grey H x W, or colour H x W x 3 in OpenCV's B, G, R order. `stride` n
looks at every n-th pixel in both directions, with its true neighbours, so that a score of a large
picture is estimated without blurring its noise away.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

SOBEL_MAX_SQUARED = 2 * (4 * 255) ** 2
"""The square of the largest Sobel gradient of an 8-bit picture."""

LAMBDA, DELTA = 1e3, 0.06
"""Steepness and threshold of the gradient information (Shim et al. 2014; thesis eq. 3.2)."""

_NORM = math.log(LAMBDA * (1 - DELTA) + 1)


def mean_dn(image: NDArray[np.uint8]) -> float:
    """Return the mean grey of a grey picture or a mosaic, 0..255."""
    mean = float(cv2.mean(image)[0])
    return min(mean, 255.0)  # OpenCV's sum times 1/n may end a bit above a white picture's 255


def entropy_bits(grey: NDArray[np.uint8]) -> float:
    """Return the Shannon entropy of the grey levels, 0..8 bits (thesis eq. 3.1, one channel)."""
    counts = _histogram(grey)
    shares = counts[counts > 0] / grey.size
    return float(-(shares * np.log2(shares)).sum()) + 0.0


def shim_gradient(grey: NDArray[np.uint8]) -> float:
    """Return the sum of the gradient information over a picture (Shim et al. 2014; eq. 3.2)."""
    information = _information(_squared_gradient(grey, 1))
    return float(information.sum(dtype=np.float64))


@dataclass(frozen=True, slots=True)
class ShinVariant:
    """The constants in which published forms of the metric differ.

    `homogeneous_share` is the share of pixels, those of the lowest gradients, in which noise is
    measured; None takes the pixels below `DELTA`. `noise_divisor` is that of Immerkaer's
    estimator. `flat_gradient` and `unknown_noise_dn` are the terms of a picture without gradients
    and of one with too few pixels to measure noise in; `unknown_noise_dn` None measures in all.
    """

    alpha: float
    beta: float
    gradient_gain: float
    degrees_of_freedom_lost: int
    homogeneous_share: float | None
    noise_divisor: float
    channel_weights: tuple[float, float, float]
    flat_gradient: float
    pixels_share_min: float
    pixels_min: int
    unknown_noise_dn: float | None


SHIN_VARIANTS: Mapping[str, ShinVariant] = {
    "authors": ShinVariant(0.4, 0.4, 2.0, 1, 0.1, 6.0, (1 / 3, 1 / 3, 1 / 3), 0.0, 1e-4, 1, None),
    "authors-cpp": ShinVariant(0.5, 0.4, 1.0, 0, 0.1, 6.0, (0.25, 0.5, 0.25), 10.0, 0.0, 11, 20.0),
    "thesis": ShinVariant(0.4, 0.4, 2.0, 0, None, 1.0, (1 / 3, 1 / 3, 1 / 3), 0.0, 0.0, 1, 0.0),
}
"""The authors' MATLAB code, their C++ code, and the equations as thesis 3.2 prints them."""

SHIN_GRID = 10
SHIN_ENTROPY_GAIN = 1 / 8
SHIN_UNSATURATED_DN = (15, 235)


@dataclass(frozen=True, slots=True)
class ShinScore:
    """The metric of Shin et al. 2019 and its terms; `flat` tells that there are no gradients."""

    score: float
    gradient: float
    entropy: float
    noise_dn: float
    flat: bool


def shin(picture: NDArray[np.uint8], variant: str = "authors", stride: int = 1) -> ShinScore:
    """Return the noise-aware score of a picture (Shin et al. 2019; thesis eq. 3.11 to 3.16).

    `variant` is a key of `SHIN_VARIANTS`. Gradient and entropy are of the grey picture; noise is
    measured in each channel, where the grey picture is homogeneous and the channel unsaturated.
    Raises ValueError for a picture with fewer than 10 x 10 inner pixels at the given stride.
    """
    form = SHIN_VARIANTS[variant]
    grey = picture if picture.ndim == 2 else _grey(picture)
    squared = _squared_gradient(grey, stride)
    if min(squared.shape) < SHIN_GRID:
        raise ValueError(f"picture is too small for a {SHIN_GRID} x {SHIN_GRID} grid: {grey.shape}")
    cells = _cell_means(_information(squared), SHIN_GRID)
    flat = not cells.any()
    gradient = form.flat_gradient if flat else _evenness(cells, form)
    entropy = SHIN_ENTROPY_GAIN * entropy_bits(grey[1:-1:stride, 1:-1:stride])
    noise_dn = _noise_dn(np.atleast_3d(picture), squared, stride, form)
    score = form.alpha * gradient + (1 - form.alpha) * entropy - form.beta * noise_dn
    return ShinScore(score, gradient, entropy, noise_dn, flat)


def _grey(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8)


def _evenness(cells: NDArray[np.float64], form: ShinVariant) -> float:
    """Return the mean over the deviation of the cells (eq. 3.12); equal cells count as flat."""
    deviation = float(cells.std(ddof=form.degrees_of_freedom_lost))
    mean = float(cells.mean())
    return form.gradient_gain * mean / deviation if deviation > 1e-9 * mean else form.flat_gradient


def _noise_dn(
    picture: NDArray[np.uint8], squared: NDArray[np.int32], stride: int, form: ShinVariant
) -> float:
    """Return the standard deviation of the noise, in grey levels (eq. 3.14 and 3.15)."""
    sums, counts = _noise_sums(picture, squared, stride, _threshold(squared, form), True)
    too_few = max(form.pixels_min, form.pixels_share_min * squared.size)
    if (counts < too_few).any() and form.unknown_noise_dn is None:
        sums, counts = _noise_sums(picture, squared, stride, SOBEL_MAX_SQUARED, False)
    known = counts >= too_few
    scale = math.sqrt(math.pi / 2) / form.noise_divisor
    noise_dn = np.full(len(counts), form.unknown_noise_dn or 0.0)
    noise_dn[known] = scale * sums[known] / counts[known]
    weights = form.channel_weights if len(counts) == 3 else (1.0,)
    return float(noise_dn @ weights)


def _threshold(squared: NDArray[np.int32], form: ShinVariant) -> int:
    """Return the largest squared gradient that still counts as homogeneous."""
    if form.homogeneous_share is None:
        return math.floor(DELTA**2 * SOBEL_MAX_SQUARED)
    rank = int(form.homogeneous_share * squared.size)
    return int(np.partition(squared.ravel(), rank)[rank])


def _cell_means(values: NDArray[np.float32], cells: int) -> NDArray[np.float64]:
    """Return the means over a grid of cells x cells nearly equal rectangles."""
    rows, columns = (np.arange(cells + 1) * side // cells for side in values.shape)
    by_row = np.add.reduceat(values, rows[:-1], axis=0, dtype=np.float64)
    sums = np.add.reduceat(by_row, columns[:-1], axis=1)
    return np.asarray(sums / np.outer(np.diff(rows), np.diff(columns)))


@njit(cache=True, nogil=True)
def _histogram(grey: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the number of pixels of each of the 256 grey levels."""
    counts = np.zeros(256, np.int64)
    for row in range(grey.shape[0]):
        for column in range(grey.shape[1]):
            counts[grey[row, column]] += 1
    return counts


@njit(cache=True, nogil=True)
def _squared_gradient(grey: NDArray[np.uint8], stride: int) -> NDArray[np.int32]:
    """Return the squared Sobel gradients of every `stride`-th inner pixel."""
    height, width = (grey.shape[0] - 3) // stride + 1, (grey.shape[1] - 3) // stride + 1
    squared = np.empty((max(height, 0), max(width, 0)), np.int32)
    for row in range(squared.shape[0]):
        y = row * stride
        above, here, below = grey[y], grey[y + 1], grey[y + 2]
        for column in range(squared.shape[1]):
            x = column * stride
            a, b, c = np.int32(above[x]), np.int32(above[x + 1]), np.int32(above[x + 2])
            d, f = np.int32(here[x]), np.int32(here[x + 2])
            g, h, i = np.int32(below[x]), np.int32(below[x + 1]), np.int32(below[x + 2])
            across = c - a + 2 * (f - d) + i - g
            down = g - a + 2 * (h - b) + i - c
            squared[row, column] = across * across + down * down
    return squared


@njit(cache=True, nogil=True)
def _information(squared: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return the information of squared Sobel gradients, 0..1 (thesis eq. 3.2)."""
    information = np.empty(squared.shape, np.float32)
    scale, steepness = np.float32(1 / math.sqrt(SOBEL_MAX_SQUARED)), np.float32(LAMBDA)
    share, delta, zero = np.float32(1 / _NORM), np.float32(DELTA), np.float32(0)
    for row in range(squared.shape[0]):
        for column in range(squared.shape[1]):
            magnitude = scale * math.sqrt(np.float32(squared[row, column]))
            excess = max(magnitude - delta, zero)
            information[row, column] = share * math.log(steepness * excess + np.float32(1))
    return information


@njit(cache=True, nogil=True)
def _noise_sums(
    picture: NDArray[np.uint8],
    squared: NDArray[np.int32],
    stride: int,
    threshold: int,
    unsaturated_only: bool,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return per channel the summed responses of Immerkaer's kernel and their number."""
    channels = picture.shape[2]
    sums, counts = np.zeros(channels, np.float64), np.zeros(channels, np.int64)
    low, high = SHIN_UNSATURATED_DN if unsaturated_only else (0, 255)
    for row in range(squared.shape[0]):
        for column in range(squared.shape[1]):
            if squared[row, column] > threshold:
                continue
            y, x = row * stride + 1, column * stride + 1
            for k in range(channels):
                centre = np.int32(picture[y, x, k])
                if centre < low or centre > high:
                    continue
                sides = np.int32(picture[y - 1, x, k]) + np.int32(picture[y + 1, x, k])
                sides += np.int32(picture[y, x - 1, k]) + np.int32(picture[y, x + 1, k])
                corners = np.int32(picture[y - 1, x - 1, k]) + np.int32(picture[y - 1, x + 1, k])
                corners += np.int32(picture[y + 1, x - 1, k]) + np.int32(picture[y + 1, x + 1, k])
                sums[k] += abs(4 * centre - 2 * sides + corners)
                counts[k] += 1
    return sums, counts
