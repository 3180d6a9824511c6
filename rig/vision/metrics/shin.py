"""The noise-aware score of a picture (Shin et al. 2019; thesis eq. 3.11 to 3.16).

score = alpha x gradient + (1 - alpha) x entropy - beta x noise. Pictures are 8-bit: grey H x W, or
colour H x W x 3 in OpenCV's B, G, R order. What the variants differ in stands in SHIN_VARIANTS.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from rig.vision.metrics.gradient import (
    DELTA,
    SOBEL_MAX_SQUARED,
    gradient_information,
    squared_sobel,
)
from rig.vision.metrics.sampling import Places, bordered
from rig.vision.metrics.tone import entropy_bits

Picture = NDArray[np.uint8]

MATLAB_GREY = (0.298936021293776, 0.587043074451121, 0.114020904255103)
"""The shares of red, green and blue in MATLAB's rgb2gray."""

Cells = Literal["all", "equal"]
"""A grid over all pixels, or of equal cells with what is left over cut off."""


@dataclass(frozen=True, slots=True)
class ShinVariant:
    """The constants and habits in which published forms of the metric differ.

    `homogeneous_rank` returns, of a number of pixels, the rank of the gradient up to which a
    pixel counts as homogeneous; None takes the pixels up to `DELTA`. `noise_divisor` is that of
    Immerkaer's estimator. `gradient_border` and `noise_border` are OpenCV's names for what lies
    beyond the picture. `flat_gradient` and `unknown_noise_dn` are the terms of a picture without
    gradients and of one with too few pixels to measure noise in; `unknown_noise_dn` None measures
    in all pixels.
    """

    alpha: float
    beta: float
    gradient_gain: float
    degrees_of_freedom_lost: int
    homogeneous_rank: Callable[[int], int] | None
    noise_divisor: float
    channel_weights: tuple[float, float, float]
    flat_gradient: float
    pixels_share_min: float
    pixels_min: int
    unknown_noise_dn: float | None
    grey: Callable[[Picture], Picture]
    cells: Cells
    gradient_border: int
    noise_border: int


SHIN_GRID = 10
SHIN_ENTROPY_GAIN = 1 / 8
SHIN_UNSATURATED_DN = (15, 235)
HOMOGENEOUS_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class ShinScore:
    """The metric and its terms; `flat` tells that there are no gradients."""

    score: float
    gradient: float
    entropy: float
    noise_dn: float
    flat: bool


def shin(picture: Picture, variant: str = "authors") -> ShinScore:
    """Return the score of every pixel of a picture; `variant` is a key of `SHIN_VARIANTS`.

    Gradient and entropy are of the grey picture; noise is measured in each channel, where the
    channel is homogeneous and unsaturated. Raises ValueError for a picture under 10 x 10 pixels.
    """
    form = SHIN_VARIANTS[variant]
    grey = picture if picture.ndim == 2 else form.grey(picture)
    wide_grey, places = bordered(grey, form.gradient_border)
    for_gradient, _ = bordered(picture, form.gradient_border)
    for_noise, _ = bordered(picture, form.noise_border)
    return _score(wide_grey, for_gradient, for_noise, places, entropy_bits(grey), form)


def shin_at(picture: Picture, places: Places, variant: str = "authors") -> ShinScore:
    """Return the score of some places inside a picture, with their true neighbours.

    Raises ValueError for fewer than 10 x 10 places.
    """
    form = SHIN_VARIANTS[variant]
    grey = picture if picture.ndim == 2 else _grey(picture)
    bits = entropy_bits(grey[np.ix_(*places)])
    return _score(grey, picture, picture, places, bits, form)


def _score(
    grey: Picture,
    for_gradient: Picture,
    for_noise: Picture,
    places: Places,
    bits: float,
    form: ShinVariant,
) -> ShinScore:
    squared = squared_sobel(grey, *places)
    if min(squared.shape) < SHIN_GRID:
        raise ValueError(f"picture is too small for a {SHIN_GRID} x {SHIN_GRID} grid: {grey.shape}")
    cells = _cell_means(gradient_information(squared), form.cells)
    flat = not cells.any()
    gradient = form.flat_gradient if flat else _evenness(cells, form)
    entropy = SHIN_ENTROPY_GAIN * bits
    noise_dn = _noise_dn(for_gradient, for_noise, places, form)
    score = form.alpha * gradient + (1 - form.alpha) * entropy - form.beta * noise_dn
    return ShinScore(score, gradient, entropy, noise_dn, flat)


def _evenness(cells: NDArray[np.float64], form: ShinVariant) -> float:
    """Return the mean over the deviation of the cells (eq. 3.12); equal cells count as flat."""
    deviation = float(cells.std(ddof=form.degrees_of_freedom_lost))
    mean = float(cells.mean())
    return form.gradient_gain * mean / deviation if deviation > 1e-9 * mean else form.flat_gradient


def _noise_dn(
    for_gradient: Picture, for_noise: Picture, places: Places, form: ShinVariant
) -> float:
    """Return the standard deviation of the noise, in grey levels (eq. 3.14 and 3.15)."""
    seen = cv2.split(for_gradient)
    noisy = seen if for_noise is for_gradient else cv2.split(for_noise)
    levels = [
        _channel_noise_dn(np.asarray(gradient, np.uint8), np.asarray(noise, np.uint8), places, form)
        for gradient, noise in zip(seen, noisy, strict=True)
    ]
    weights = form.channel_weights if len(levels) == 3 else (1.0,)
    return float(np.dot(levels, weights))


def _channel_noise_dn(
    for_gradient: Picture, for_noise: Picture, places: Places, form: ShinVariant
) -> float:
    squared = squared_sobel(for_gradient, *places)
    scale = math.sqrt(math.pi / 2) / form.noise_divisor
    total, count = _noise_sum(for_noise, squared, *places, _threshold(squared, form))
    if count >= max(form.pixels_min, form.pixels_share_min * squared.size):
        return scale * total / count
    if form.unknown_noise_dn is not None:
        return form.unknown_noise_dn
    everywhere = _response_sum(for_noise, *places)
    return scale * everywhere / math.prod(max(len(side) - 2, 1) for side in places)


def _threshold(squared: NDArray[np.int32], form: ShinVariant) -> int:
    """Return the largest squared gradient that still counts as homogeneous."""
    if form.homogeneous_rank is None:
        return math.floor(DELTA**2 * SOBEL_MAX_SQUARED)
    rank = form.homogeneous_rank(squared.size)
    return int(np.partition(squared.ravel(), rank)[rank])


def _cell_means(values: NDArray[np.float32], cells: Cells) -> NDArray[np.float64]:
    """Return the means over a grid of 10 x 10 rectangles."""
    if cells == "equal":
        height, width = (side // SHIN_GRID * SHIN_GRID for side in values.shape)
        values = values[:height, :width]
    rows, columns = (np.arange(SHIN_GRID + 1) * side // SHIN_GRID for side in values.shape)
    by_row = np.add.reduceat(values, rows[:-1], axis=0, dtype=np.float64)
    sums = np.add.reduceat(by_row, columns[:-1], axis=1)
    return np.asarray(sums / np.outer(np.diff(rows), np.diff(columns)))


def _grey(picture: Picture) -> Picture:
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8)


def _matlab_grey(picture: Picture) -> Picture:
    """Return the grey picture as MATLAB's rgb2gray rounds it."""
    red, green, blue = MATLAB_GREY
    weighted = picture.astype(np.float64) @ np.array([blue, green, red])
    return np.asarray(np.floor(weighted + 0.5), np.uint8)


def _matlab_rank(pixels: int) -> int:
    return max(math.floor(HOMOGENEOUS_SHARE * pixels + 0.5) - 1, 0)


def _cpp_rank(pixels: int) -> int:
    return math.floor(float(np.float32(pixels) * np.float32(HOMOGENEOUS_SHARE)) + 0.5)


SHIN_VARIANTS: Mapping[str, ShinVariant] = {
    "authors": ShinVariant(
        alpha=0.4,
        beta=0.4,
        gradient_gain=2.0,
        degrees_of_freedom_lost=1,
        homogeneous_rank=_matlab_rank,
        noise_divisor=6.0,
        channel_weights=(1 / 3, 1 / 3, 1 / 3),
        flat_gradient=0.0,
        pixels_share_min=1e-4,
        pixels_min=1,
        unknown_noise_dn=None,
        grey=_matlab_grey,
        cells="all",
        gradient_border=cv2.BORDER_REPLICATE,
        noise_border=cv2.BORDER_CONSTANT,
    ),
    "authors-cpp": ShinVariant(
        alpha=0.5,
        beta=0.4,
        gradient_gain=1.0,
        degrees_of_freedom_lost=0,
        homogeneous_rank=_cpp_rank,
        noise_divisor=6.0,
        channel_weights=(0.25, 0.5, 0.25),
        flat_gradient=10.0,
        pixels_share_min=0.0,
        pixels_min=11,
        unknown_noise_dn=20.0,
        grey=_grey,
        cells="equal",
        gradient_border=cv2.BORDER_REFLECT_101,
        noise_border=cv2.BORDER_REFLECT_101,
    ),
    "thesis": ShinVariant(
        alpha=0.4,
        beta=0.4,
        gradient_gain=2.0,
        degrees_of_freedom_lost=0,
        homogeneous_rank=None,
        noise_divisor=1.0,
        channel_weights=(1 / 3, 1 / 3, 1 / 3),
        flat_gradient=0.0,
        pixels_share_min=0.0,
        pixels_min=1,
        unknown_noise_dn=0.0,
        grey=_grey,
        cells="all",
        gradient_border=cv2.BORDER_REFLECT_101,
        noise_border=cv2.BORDER_REFLECT_101,
    ),
}
"""The authors' MATLAB code, their C++ code, and the equations as thesis 3.2 prints them."""


@njit(cache=True, nogil=True)
def _noise_sum(
    channel: NDArray[np.uint8],
    squared: NDArray[np.int32],
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    threshold: int,
) -> tuple[float, int]:
    """Return the summed responses of Immerkaer's kernel where it may be used, and their number."""
    total, count = 0.0, 0
    low, high = SHIN_UNSATURATED_DN
    for i in range(len(rows)):
        for j in range(len(columns)):
            if squared[i, j] > threshold:
                continue
            centre = channel[rows[i], columns[j]]
            if low <= centre <= high:
                total += _response(channel, rows[i], columns[j])
                count += 1
    return total, count


@njit(cache=True, nogil=True)
def _response_sum(
    channel: NDArray[np.uint8], rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> float:
    """Return the summed responses of Immerkaer's kernel at all places."""
    total = 0.0
    for y in rows:
        for x in columns:
            total += _response(channel, y, x)
    return total


@njit(inline="always")
def _response(channel: NDArray[np.uint8], y: int, x: int) -> np.int32:
    sides = np.int32(channel[y - 1, x]) + np.int32(channel[y + 1, x])
    sides += np.int32(channel[y, x - 1]) + np.int32(channel[y, x + 1])
    corners = np.int32(channel[y - 1, x - 1]) + np.int32(channel[y - 1, x + 1])
    corners += np.int32(channel[y + 1, x - 1]) + np.int32(channel[y + 1, x + 1])
    return abs(4 * np.int32(channel[y, x]) - 2 * sides + corners)
