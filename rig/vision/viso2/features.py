"""Features: local extrema of four classes, each with 32 bytes of the gradients around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rig.vision.viso2.filters import Gradients

CLASSES = 4
"""Blob minima, blob maxima, corner minima, corner maxima, in this order."""

RESPONSE_MIN = 50
"""A weaker extremum of a filter is noise."""

MARGIN_PX = 6
"""How far from the border extrema stay, beside the reach of the suppression."""

DESCRIPTOR_BYTES = 32
BIN_PX = 50
"""Features are kept in square bins of this side, by which they are found again."""


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """How a picture is cut into square bins; the last row and column may be narrow."""

    rows: int
    columns: int

    @classmethod
    def of(cls, height_px: int, width_px: int) -> Bins:
        """Return the bins that cover a picture."""
        return cls(max(1, -(-height_px // BIN_PX)), max(1, -(-width_px // BIN_PX)))


@dataclass(frozen=True, slots=True, eq=False)
class FeatureSet:
    """Features in order of class, bin row and bin column.

    `xy_px` is int32 N x 2 in pixels of the full picture, `descriptors` uint8 N x 32. Those of
    class c in the bin (row, column) are `starts[k]` up to `starts[k + 1]`, where k is
    (c * rows + row) * columns + column; `starts` has one entry more than there are such groups.
    """

    xy_px: NDArray[np.int32]
    classes: NDArray[np.uint8]
    descriptors: NDArray[np.uint8]
    starts: NDArray[np.int64]
    bins: Bins

    def __len__(self) -> int:
        return len(self.xy_px)


def find_features(
    responses: tuple[NDArray[np.int16], NDArray[np.int16]],
    slopes: Gradients,
    reach_px: int,
    scale: int,
    bins: Bins,
) -> FeatureSet:
    """Return the extrema of the (blob, corner) responses that rule `reach_px` around themselves.

    The suppression is that of Neubeck and Van Gool (ICPR 2006). `scale` is how many pixels of the
    full picture one of the responses is.
    """
    blob, corner = responses
    found = _suppress(blob, corner, reach_px)
    xy_px, classes = found[:, :2] * np.int32(scale), found[:, 2]
    row, column = xy_px[:, 1] // BIN_PX, xy_px[:, 0] // BIN_PX
    group = (classes.astype(np.int64) * bins.rows + row) * bins.columns + column
    groups = CLASSES * bins.rows * bins.columns
    # Numbers of 16 bits, as all usual pictures have, are sorted by digits, which is fast.
    order = np.argsort(group.astype(np.min_scalar_type(groups)), kind="stable")
    starts = np.zeros(groups + 1, np.int64)
    np.cumsum(np.bincount(group, minlength=groups), out=starts[1:])
    return FeatureSet(
        xy_px=np.ascontiguousarray(xy_px[order]),
        classes=classes[order].astype(np.uint8),
        descriptors=_describe(found[order], slopes.right, slopes.down),
        starts=starts,
        bins=bins,
    )


@njit(cache=True, nogil=True)
def _suppress(
    blob: NDArray[np.int16], corner: NDArray[np.int16], reach_px: int
) -> NDArray[np.int32]:
    """Return the extrema, N x 3 (column, row, class): at most one of a class in a block."""
    rows, columns = blob.shape
    first = reach_px + MARGIN_PX
    step = reach_px + 1
    across = max(0, -(-(columns - 2 * first) // step))
    along = max(0, -(-(rows - 2 * first) // step))
    found = np.empty((across * along * CLASSES, 3), np.int32)
    count = 0
    for top in range(first, rows - first, step):
        for left in range(first, columns - first, step):
            for pair in range(2):
                response = blob if pair == 0 else corner
                low_row, low_column, high_row, high_column = _extremes(response, top, left, step)
                low, high = response[low_row, low_column], response[high_row, high_column]
                if low <= -RESPONSE_MIN and _lowest(response, low_row, low_column, reach_px):
                    found[count] = low_column, low_row, 2 * pair
                    count += 1
                if high >= RESPONSE_MIN and _highest(response, high_row, high_column, reach_px):
                    found[count] = high_column, high_row, 2 * pair + 1
                    count += 1
    return found[:count]


@njit(cache=True, nogil=True)
def _extremes(
    response: NDArray[np.int16], top: int, left: int, step: int
) -> tuple[int, int, int, int]:
    """Return where a block is lowest and where it is highest (row, column, row, column)."""
    low_row, low_column, high_row, high_column = top, left, top, left
    low = high = response[top, left]
    for row in range(top, top + step):
        for column in range(left, left + step):
            value = response[row, column]
            if value < low:
                low, low_row, low_column = value, row, column
            elif value > high:
                high, high_row, high_column = value, row, column
    return low_row, low_column, high_row, high_column


@njit(cache=True, nogil=True)
def _lowest(response: NDArray[np.int16], row: int, column: int, reach_px: int) -> bool:
    """Return whether nothing within reach is lower; equals may stand side by side."""
    value = response[row, column]
    bottom = min(row + reach_px, response.shape[0] - 1 - MARGIN_PX)
    right = min(column + reach_px, response.shape[1] - 1 - MARGIN_PX)
    for y in range(row - reach_px, bottom + 1):
        for x in range(column - reach_px, right + 1):
            if response[y, x] < value:
                return False
    return True


@njit(cache=True, nogil=True)
def _highest(response: NDArray[np.int16], row: int, column: int, reach_px: int) -> bool:
    """Return whether nothing within reach is higher; equals may stand side by side."""
    value = response[row, column]
    bottom = min(row + reach_px, response.shape[0] - 1 - MARGIN_PX)
    right = min(column + reach_px, response.shape[1] - 1 - MARGIN_PX)
    for y in range(row - reach_px, bottom + 1):
        for x in range(column - reach_px, right + 1):
            if response[y, x] > value:
                return False
    return True


_AROUND = np.array(
    [
        (sx * x, sy * y)
        for x, y in ((1, 1), (3, 1), (1, 5), (5, 3))
        for sx in (-1, 1)
        for sy in (-1, 1)
    ],
    np.int64,
)
"""The 16 places, (right, down), whose two derivatives make the descriptor."""


@njit(cache=True, nogil=True)
def _describe(
    found: NDArray[np.int32], right: NDArray[np.uint8], down: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """Return 32 bytes a feature: the derivatives to the right at 16 places, then those downwards.

    The margin keeps every place inside the picture.
    """
    descriptors = np.empty((len(found), DESCRIPTOR_BYTES), np.uint8)
    for i in range(len(found)):
        for k in range(len(_AROUND)):
            x, y = found[i, 0] + _AROUND[k, 0], found[i, 1] + _AROUND[k, 1]
            descriptors[i, k] = right[y, x]
            descriptors[i, len(_AROUND) + k] = down[y, x]
    return descriptors
