"""The pictures in which features are found and compared: blobs, corners, gradients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

_BLOB = np.full((5, 5), -1, np.float32)
_BLOB[1:4, 1:4] = 1
_BLOB[2, 2] = 8

_ROWS = np.array([1, 1, 0, -1, -1], np.float32)
_COLUMNS = np.array([-1, -1, 0, 1, 1], np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Gradients:
    """Sobel 5 x 5 derivatives to the right and downwards, H x W bytes around 128."""

    right: NDArray[np.uint8]
    down: NDArray[np.uint8]


def half(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the picture at half the size: means of 2 x 2 pixels, rounded down.

    An odd last row or column is left out.
    """
    return np.asarray(_half(np.ascontiguousarray(grey)))


@njit(cache=True, nogil=True)
def _half(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    rows, columns = grey.shape[0] // 2, grey.shape[1] // 2
    small = np.empty((rows, columns), np.uint8)
    for row in range(rows):
        upper, lower, target = grey[2 * row], grey[2 * row + 1], small[row]
        for column in range(columns):
            left = np.uint16(upper[2 * column]) + np.uint16(lower[2 * column])
            right = np.uint16(upper[2 * column + 1]) + np.uint16(lower[2 * column + 1])
            target[column] = (left + right) >> 2
    return small


def blobs(grey: NDArray[np.uint8]) -> NDArray[np.int16]:
    """Return the response to a bright spot: 5 x 5, ring -1, inner ring 1, centre 8."""
    return _i16(cv2.filter2D(grey, cv2.CV_16S, _BLOB, borderType=cv2.BORDER_REPLICATE))


def corners(grey: NDArray[np.uint8]) -> NDArray[np.int16]:
    """Return the response to a 5 x 5 checkerboard of two by two fields."""
    return _i16(cv2.sepFilter2D(grey, cv2.CV_16S, _COLUMNS, _ROWS, borderType=cv2.BORDER_REPLICATE))


def gradients(grey: NDArray[np.uint8]) -> Gradients:
    """Return the Sobel derivatives, each shifted right by 7 bits (rounding down), plus 128.

    The border is repeated outwards.
    """
    padded = cv2.copyMakeBorder(grey, 2, 2, 2, 2, cv2.BORDER_REPLICATE)
    return Gradients(*_slopes(np.asarray(padded, np.uint8)))


@njit(cache=True, nogil=True)
def _slopes(padded: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return both derivatives; each is within 48 x 255, so that the shift needs no clipping.

    Row by row, in 16 bits, so that many columns are done at once.
    """
    rows, width = padded.shape[0] - 4, padded.shape[1]
    columns = width - 4
    right, down = np.empty((rows, columns), np.uint8), np.empty((rows, columns), np.uint8)
    smooth, change = np.empty(width, np.int16), np.empty(width, np.int16)
    across, along = np.empty(columns, np.int16), np.empty(columns, np.int16)
    for row in range(rows):
        a, b, c = padded[row], padded[row + 1], padded[row + 2]
        d, e = padded[row + 3], padded[row + 4]
        for x in range(width):
            smooth[x] = np.int16(a[x]) + 4 * np.int16(b[x]) + 6 * np.int16(c[x]) + 4 * d[x] + e[x]
            change[x] = 2 * (np.int16(d[x]) - np.int16(b[x])) + np.int16(e[x]) - np.int16(a[x])
        for x in range(columns):
            across[x] = 2 * (smooth[x + 3] - smooth[x + 1]) + smooth[x + 4] - smooth[x]
            ends, sides = change[x] + change[x + 4], change[x + 1] + change[x + 3]
            along[x] = ends + 4 * sides + 6 * change[x + 2]
        to_right, to_down = right[row], down[row]
        for x in range(columns):
            to_right[x] = np.uint8((across[x] >> 7) + 128)
            to_down[x] = np.uint8((along[x] >> 7) + 128)
    return right, down


def _i16(picture: Any) -> NDArray[np.int16]:
    return np.asarray(picture, np.int16)
