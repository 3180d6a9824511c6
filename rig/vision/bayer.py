"""From the sensor's mosaic to the pictures that others look at.

A `bayer_rggb8` mosaic has red at row 0, column 0, green at (0, 1) and (1, 0), blue at (1, 1).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from rig.core.types import PixelFormat

NETWORK_PX = 224
"""The side of the square picture that the networks look at (thesis 4.2.5)."""

_RED, _GREEN, _BLUE = 0, 1, 2

_MOSAICS: dict[PixelFormat, tuple[int, tuple[tuple[int, int, int, float], ...]]] = {
    "bayer_rggb8": (
        2,
        ((0, 0, _RED, 1.0), (0, 1, _GREEN, 0.5), (1, 0, _GREEN, 0.5), (1, 1, _BLUE, 1.0)),
    ),
    "mono8": (1, ((0, 0, _RED, 1.0), (0, 0, _GREEN, 1.0), (0, 0, _BLUE, 1.0))),
}
"""The period of each mosaic, and per filter its row, its column, its channel and its share."""


def to_grey(image: NDArray[np.uint8], pixel_format: PixelFormat) -> NDArray[np.uint8]:
    """Return the H x W grey picture: bilinear demosaic, 0.299 R + 0.587 G + 0.114 B."""
    if pixel_format == "mono8":
        return image
    return _u8(cv2.cvtColor(image, cv2.COLOR_BayerRGGB2GRAY))


def to_bgr(image: NDArray[np.uint8], pixel_format: PixelFormat) -> NDArray[np.uint8]:
    """Return the H x W x 3 picture in OpenCV's channel order, for files and pages."""
    code = cv2.COLOR_GRAY2BGR if pixel_format == "mono8" else cv2.COLOR_BayerRGGB2BGR
    return _u8(cv2.cvtColor(image, code))


def to_rgb224(image: NDArray[np.uint8], pixel_format: PixelFormat) -> NDArray[np.float32]:
    """Return the 3 x 224 x 224 network picture, channels R, G, B in 0..1.

    Every 2 x 2 group of the mosaic is one colour pixel (the greens averaged), a square of constant
    colour; the picture is cut into 224 x 224 equal cells and each becomes its area average. So the
    picture is defined for every size: cell edges may cut pixels, and a small picture is enlarged.
    Raises ValueError when the image is not whole mosaic groups.
    """
    period, filters = _MOSAICS[pixel_format]
    height_px, width_px = image.shape
    if min(image.shape) == 0 or height_px % period or width_px % period:
        raise ValueError(f"{pixel_format} needs whole groups, got {width_px} x {height_px} px")
    bands = _average_rows(image, period, *_overlaps(height_px // period))
    first, weights = _overlaps(width_px // period)
    picture = np.zeros((3, NETWORK_PX, NETWORK_PX), np.float32)
    for row, column, channel, share in filters:
        shares = weights * np.float32(share / 255)
        _add_columns(bands[row, :, column::period], first, shares, picture[channel])
    return picture


def _overlaps(groups: int) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return for each of 224 cells its first group and, 224 x K, its share of K from there on."""
    edges = np.arange(NETWORK_PX + 1) * groups / NETWORK_PX
    left, right = edges[:-1, None], edges[1:, None]
    widest = int((np.ceil(right) - np.floor(left)).max())
    first = np.minimum(left.astype(np.int64), groups - widest)
    group = first + np.arange(widest)
    overlap = np.minimum(right, group + 1) - np.maximum(left, group)
    weights = np.maximum(overlap, 0) * (NETWORK_PX / groups)
    return first[:, 0], weights.astype(np.float32)


@njit(cache=True, nogil=True)
def _average_rows(
    image: NDArray[np.uint8], period: int, first: NDArray[np.int64], weights: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the area averages over 224 bands, per row of the mosaic: period x 224 x W."""
    width_px = image.shape[1]
    bands = np.zeros((period, NETWORK_PX, width_px), np.float32)
    for band in range(NETWORK_PX):
        for k, weight in enumerate(weights[band]):
            if weight == 0:
                continue
            for row in range(period):
                source = image[(first[band] + k) * period + row]
                target = bands[row, band]
                for column in range(width_px):
                    target[column] += weight * np.float32(source[column])
    return bands


@njit(cache=True, nogil=True)
def _add_columns(
    bands: NDArray[np.float32],
    first: NDArray[np.int64],
    weights: NDArray[np.float32],
    channel: NDArray[np.float32],
) -> None:
    """Add to the 224 x 224 `channel` the weighted sums over the columns of `bands`."""
    for band in range(NETWORK_PX):
        for cell in range(NETWORK_PX):
            total = np.float32(0)
            for k in range(weights.shape[1]):
                total += weights[cell, k] * bands[band, first[cell] + k]
            channel[band, cell] += total


def _u8(picture: Any) -> NDArray[np.uint8]:
    return np.asarray(picture, dtype=np.uint8)
