"""A picture at a glance: 64 x 48 cells, how bright each is and how much of it is saturated."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rig.core.types import PixelFormat

THUMBNAIL_PX = (64, 48)
"""Width and height in cells."""

SATURATED_DN = 250

_PERIODS: dict[PixelFormat, int] = {"bayer_rggb8": 2, "mono8": 1}


def thumbnail(image: NDArray[np.uint8], pixel_format: PixelFormat) -> NDArray[np.uint8]:
    """Return 2 x 48 x 64: the mean of each cell, and the share of saturated pixels in 0..255.

    A cell is a block of whole mosaic groups, so in a Bayer picture green counts twice. Raises
    ValueError when the image is not whole groups, or has fewer of them than cells.
    """
    period = _PERIODS[pixel_format]
    height_px, width_px = image.shape
    columns, rows = THUMBNAIL_PX
    whole = height_px % period == 0 and width_px % period == 0
    if not whole or height_px < rows * period or width_px < columns * period:
        raise ValueError(
            f"{pixel_format} of {width_px} x {height_px} px has no {columns} x {rows} cells"
        )
    small = np.empty((2, rows, columns), np.uint8)
    _fill(image, _edges(height_px, rows, period), _edges(width_px, columns, period), small)
    return small


def _edges(pixels: int, cells: int, period: int) -> NDArray[np.int64]:
    """Return where cells begin and the last one ends, as even as whole groups allow."""
    return np.arange(cells + 1) * (pixels // period) // cells * period


@njit(cache=True, nogil=True)
def _fill(
    image: NDArray[np.uint8],
    top: NDArray[np.int64],
    left: NDArray[np.int64],
    small: NDArray[np.uint8],
) -> None:
    rows, columns = small.shape[1:]
    total = np.empty(columns, np.int64)
    bright = np.empty(columns, np.int64)
    for row in range(rows):
        total[:] = 0
        bright[:] = 0
        for y in range(top[row], top[row + 1]):
            for column in range(columns):
                light = np.uint32(0)
                saturated = np.uint32(0)
                for value in image[y, left[column] : left[column + 1]]:
                    light += np.uint32(value)
                    saturated += np.uint32(value >= SATURATED_DN)
                total[column] += light
                bright[column] += saturated
        for column in range(columns):
            pixels = (top[row + 1] - top[row]) * (left[column + 1] - left[column])
            small[0, row, column] = (total[column] + pixels // 2) // pixels
            small[1, row, column] = (255 * bright[column] + pixels // 2) // pixels
