"""Matches between two pictures' features: there and back again, then moved by single pixels."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rig.vision.viso2.features import BIN_PX, DESCRIPTOR_BYTES, Bins, FeatureSet
from rig.vision.viso2.filters import Gradients
from rig.vision.viso2.sad import sum_of_differences

RADIUS_PX = 200
"""How far a feature may move between two pictures, in each direction."""

SPREAD_MIN_PX = 20
"""The least width of the range in which the dense pass searches."""

REFINE_PX = 2
"""How far a match is moved to fit better, in each direction."""


def no_bounds(bins: Bins, radius_px: int) -> NDArray[np.int32]:
    """Return the flow bounds, rows x columns x 4, that allow `radius_px` in every direction.

    The four are (least x, greatest x, least y, greatest y) of previous minus current, in pixels.
    """
    one = np.array([-radius_px, radius_px, -radius_px, radius_px], np.int32)
    return np.tile(one, (bins.rows, bins.columns, 1))


def flow_bounds(
    previous_px: NDArray[np.int32], current_px: NDArray[np.int32], bins: Bins, radius_px: int
) -> NDArray[np.int32]:
    """Return the flow bounds that sparse matches (N x 2 each) give to the dense pass.

    A bin takes the range of all matches in it and its eight neighbours, widened evenly to at
    least 20 px; a bin without any keeps the full radius.
    """
    return np.asarray(_bounds(previous_px, current_px, no_bounds(bins, radius_px)))


@njit(cache=True, nogil=True)
def _bounds(
    previous_px: NDArray[np.int32], current_px: NDArray[np.int32], bounds: NDArray[np.int32]
) -> NDArray[np.int32]:
    rows, columns = bounds.shape[:2]
    seen = np.zeros((rows, columns), np.bool_)
    for i in range(len(current_px)):
        row, column = current_px[i, 1] // BIN_PX, current_px[i, 0] // BIN_PX
        for y in range(max(row - 1, 0), min(row + 2, rows)):
            for x in range(max(column - 1, 0), min(column + 2, columns)):
                for axis in range(2):
                    flow = previous_px[i, axis] - current_px[i, axis]
                    low, high = 2 * axis, 2 * axis + 1
                    if not seen[y, x] or flow < bounds[y, x, low]:
                        bounds[y, x, low] = flow
                    if not seen[y, x] or flow > bounds[y, x, high]:
                        bounds[y, x, high] = flow
                seen[y, x] = True
    for y in range(rows):
        for x in range(columns):
            for axis in range(2):
                missing = SPREAD_MIN_PX - (bounds[y, x, 2 * axis + 1] - bounds[y, x, 2 * axis])
                if missing > 0:
                    widen = (missing + 1) // 2
                    bounds[y, x, 2 * axis] -= widen
                    bounds[y, x, 2 * axis + 1] += widen
    return bounds


def match_features(
    previous: FeatureSet, current: FeatureSet, bounds: NDArray[np.int32]
) -> NDArray[np.int64]:
    """Return K x 2 indices (previous, current) of features that are each other's best.

    The best is of the same class, inside the bounds of the current feature's bin, and has the
    smallest sum of absolute differences; of equals the first. A pixel of the current picture has
    one match, although it may hold features of several classes.
    """
    bins = current.bins
    taken = np.zeros((bins.rows * BIN_PX, bins.columns * BIN_PX), np.bool_)
    return np.asarray(
        _match(
            previous.xy_px,
            previous.descriptors,
            previous.starts,
            current.xy_px,
            current.descriptors,
            current.starts,
            current.classes,
            bounds,
            taken,
            (previous.bins.rows, previous.bins.columns),
        )
    )


@njit(cache=True, nogil=True)
def _match(
    previous_px: NDArray[np.int32],
    previous_bytes: NDArray[np.uint8],
    previous_starts: NDArray[np.int64],
    current_px: NDArray[np.int32],
    current_bytes: NDArray[np.uint8],
    current_starts: NDArray[np.int64],
    classes: NDArray[np.uint8],
    bounds: NDArray[np.int32],
    taken: NDArray[np.bool_],
    previous_bins: tuple[int, int],
) -> NDArray[np.int64]:
    pairs = np.empty((len(current_px), 2), np.int64)
    count = 0
    for i in range(len(current_px)):
        x, y = current_px[i]
        if taken[y, x]:
            continue
        low_x, high_x, low_y, high_y = bounds[y // BIN_PX, x // BIN_PX]
        there = _best(
            current_bytes,
            i,
            (x + low_x, x + high_x, y + low_y, y + high_y),
            previous_px,
            previous_bytes,
            previous_starts,
            classes[i],
            previous_bins,
        )
        if there < 0:
            continue
        x_there, y_there = previous_px[there]
        back = _best(
            previous_bytes,
            there,
            (x_there - high_x, x_there - low_x, y_there - high_y, y_there - low_y),
            current_px,
            current_bytes,
            current_starts,
            classes[i],
            bounds.shape[:2],
        )
        if back == i:
            taken[y, x] = True
            pairs[count] = there, i
            count += 1
    return pairs[:count]


@njit(cache=True, nogil=True)
def _best(
    wanted: NDArray[np.uint8],
    row_wanted: int,
    window_px: tuple[int, int, int, int],
    xy_px: NDArray[np.int32],
    descriptors: NDArray[np.uint8],
    starts: NDArray[np.int64],
    kind: int,
    bins: tuple[int, int],
) -> int:
    """Return the feature most like a wanted one inside a window, -1 for none.

    The window is (x from, x to, y from, y to), the ends included; `kind` is the class and `bins`
    the (rows, columns) of the picture that is searched.
    """
    rows, columns = bins
    left, right, top, bottom = window_px
    if right < 0 or bottom < 0:
        return -1
    best, least = -1, 255 * DESCRIPTOR_BYTES + 1
    first, last = max(left, 0) // BIN_PX, min(right // BIN_PX, columns - 1)
    for row in range(max(top, 0) // BIN_PX, min(bottom // BIN_PX, rows - 1) + 1):
        if first > last:
            break
        group = (np.int64(kind) * rows + row) * columns
        for i in range(starts[group + first], starts[group + last + 1]):
            x, y = xy_px[i]
            if left <= x <= right and top <= y <= bottom:
                cost = sum_of_differences(wanted, row_wanted, descriptors, i)
                if cost < least:
                    best, least = i, cost
    return best


_NEAR = ((0, 0), (0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))
_FAR = ((0, -2), (0, 2), (-2, -1), (2, -1), (-2, 1), (2, 1))
_RIGHT_PLACES = np.array([*_NEAR, *_FAR], np.int64)
"""Where the derivative to the right is compared, (right, down); the centre counts twice."""

_DOWN_PLACES = np.array([(0, -1), (0, 1), (-1, 0), (1, 0)], np.int64)
"""Where the derivative downwards is compared."""


def refine(
    previous_px: NDArray[np.int32],
    current_px: NDArray[np.int32],
    previous: Gradients,
    current: Gradients,
) -> NDArray[np.int32]:
    """Return the previous points, each moved by at most 2 px to where it fits the current best.

    Points (N x 2) must be at least 4 px from the border. A point moves only to fit better.
    """
    stride, stride_previous = current.right.shape[1], previous.right.shape[1]
    steps = np.arange(-REFINE_PX, REFINE_PX + 1)
    moves = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    chosen = _refine(
        previous_px.astype(np.int64) @ (1, stride_previous),
        current_px.astype(np.int64) @ (1, stride),
        moves @ (1, stride_previous),
        (_RIGHT_PLACES @ (1, stride), _DOWN_PLACES @ (1, stride)),
        (_RIGHT_PLACES @ (1, stride_previous), _DOWN_PLACES @ (1, stride_previous)),
        (previous.right.ravel(), previous.down.ravel()),
        (current.right.ravel(), current.down.ravel()),
    )
    return np.asarray(previous_px + moves[chosen], np.int32)


@njit(cache=True, nogil=True)
def _refine(
    previous_at: NDArray[np.int64],
    current_at: NDArray[np.int64],
    moves: NDArray[np.int64],
    current_places: tuple[NDArray[np.int64], NDArray[np.int64]],
    previous_places: tuple[NDArray[np.int64], NDArray[np.int64]],
    previous: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    current: tuple[NDArray[np.uint8], NDArray[np.uint8]],
) -> NDArray[np.int64]:
    """Return which of the moves is best for each match; points and places are flat indices.

    Pairs are (derivative to the right, derivative downwards). A move is given up once its cost
    reaches the least so far.
    """
    chosen = np.empty(len(previous_at), np.int64)
    right, down = previous
    right_places, down_places = previous_places
    wanted_right = np.empty(len(right_places), np.int16)
    wanted_down = np.empty(len(down_places), np.int16)
    still = len(moves) // 2
    for i in range(len(previous_at)):
        for k in range(len(right_places)):
            wanted_right[k] = current[0][np.uint64(current_at[i] + current_places[0][k])]
        for k in range(len(down_places)):
            wanted_down[k] = current[1][np.uint64(current_at[i] + current_places[1][k])]
        least = 1 << 30
        for attempt in range(-1, len(moves)):
            move = still if attempt < 0 else attempt
            at = previous_at[i] + moves[move]
            cost = 0
            for k in range(len(down_places)):
                cost += abs(wanted_down[k] - np.int16(down[np.uint64(at + down_places[k])]))
            for k in range(len(right_places)):
                if cost >= least:
                    break
                cost += abs(wanted_right[k] - np.int16(right[np.uint64(at + right_places[k])]))
            if cost < least:
                least = cost
                chosen[i] = move
    return chosen
