"""Counts of matches by ground truth: a feature must be found where the scene says it went.

Much cheaper than matching all features and fitting an epipolar geometry, so every move between
two settings can be counted. Simulation only: it needs depth and poses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from rig.core.types import Intrinsics
from rig.drivers.scenes.trajectories import Pose
from rig.vision.orb import ANALYSIS_SIZE_PX, OrbFeatures

RADIUS_PX = 3.0
RADIUS_OF_FLOW = 0.06
LARGEST_RADIUS_PX = 8.0
HAMMING_MAX = 50

_CELL_PX = 8
_BEHIND_M = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class FeatureSets:
    """The features of one frame for S settings, one behind the other.

    `points_px` is float32 N x 2 in pixels of the analysed picture, `words` uint64 N x 4 their
    descriptors; set s is rows `starts[s]` to `starts[s + 1]`. `exposures_us` is S long.
    """

    points_px: NDArray[np.float32]
    words: NDArray[np.uint64]
    starts: NDArray[np.int64]
    exposures_us: NDArray[np.float64]


def feature_sets(found: Sequence[OrbFeatures], exposures_us: Sequence[float]) -> FeatureSets:
    """Join the features of one frame, one item a setting."""
    return FeatureSets(
        points_px=np.concatenate([one.points_px for one in found]).astype(np.float32),
        words=np.concatenate([one.descriptors for one in found]).view(np.uint64),
        starts=np.concatenate([[0], np.cumsum([len(one) for one in found])]).astype(np.int64),
        exposures_us=np.array(exposures_us, np.float64),
    )


def flow(
    points_px: NDArray[np.float32], depth_m: NDArray[np.float32], lens: Intrinsics, a: Pose, b: Pose
) -> NDArray[np.float32]:
    """Return where points seen from pose `a` are seen from `b`, in analysed pixels; NaN behind."""
    scale = np.array(ANALYSIS_SIZE_PX) / (lens.width_px, lens.height_px)
    x, y = (((points_px + 0.5) / scale) - 0.5).T
    rows = np.clip(np.rint(y).astype(int), 0, lens.height_px - 1)
    columns = np.clip(np.rint(x).astype(int), 0, lens.width_px - 1)
    z = depth_m[rows, columns].astype(np.float64)
    ray = np.stack([(x - lens.cx_px) / lens.fx_px, (y - lens.cy_px) / lens.fy_px, np.ones_like(z)])
    seen = b.rotation @ (a.rotation.T @ (ray * z) + (a.centre - b.centre)[:, None])
    ahead = np.where(seen[2] > _BEHIND_M, seen[2], np.nan)
    there = np.stack(
        [
            seen[0] / ahead * lens.fx_px + lens.cx_px,
            seen[1] / ahead * lens.fy_px + lens.cy_px,
        ],
        axis=1,
    )
    return np.asarray((there + 0.5) * scale - 0.5, np.float32)


def count_moves(
    before: FeatureSets,
    after: FeatureSets,
    predicted_px: NDArray[np.float32],
    interval_us: float,
    allowed: NDArray[np.bool_],
) -> NDArray[np.int16]:
    """Return S x S mutual matches of each set before with each after; 0 where not `allowed`.

    `predicted_px` says where each point before is `interval_us` later; a blurred feature lies in
    the middle of its exposure, which is allowed for.
    """
    counts = np.zeros(allowed.shape, np.int16)
    columns, rows = (size // _CELL_PX for size in ANALYSIS_SIZE_PX)
    for b in range(allowed.shape[1]):
        part = slice(int(after.starts[b]), int(after.starts[b + 1]))
        points, words = after.points_px[part], after.words[part]
        if len(points) == 0:
            continue
        first, order = _indexed(points, columns, rows)
        for a in np.flatnonzero(allowed[:, b]):
            own = slice(int(before.starts[a]), int(before.starts[a + 1]))
            if own.start == own.stop:
                continue
            later_us = (after.exposures_us[b] - before.exposures_us[a]) / 2
            counts[a, b] = _mutual(
                before.points_px[own],
                predicted_px[own],
                float(1 + later_us / interval_us),
                before.words[own],
                points,
                words,
                first,
                order,
                columns,
                rows,
            )
    return counts


def _count_ones(typing_context: Any, word: Any) -> Any:
    """Count the ones of a 64-bit word in one machine instruction."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        count = builder.module.declare_intrinsic("llvm.ctpop", [arguments[0].type])
        return builder.call(count, arguments)

    return types.uint64(types.uint64), generate


_population_count: Any = intrinsic(_count_ones)


@njit(cache=True, nogil=True)
def _indexed(
    points: NDArray[np.float32], columns: int, rows: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the points' order by cell and where each cell begins in it."""
    cell = np.empty(len(points), np.int64)
    first = np.zeros(columns * rows + 1, np.int64)
    for i in range(len(points)):
        x = min(max(int(points[i, 0]) // _CELL_PX, 0), columns - 1)
        y = min(max(int(points[i, 1]) // _CELL_PX, 0), rows - 1)
        cell[i] = y * columns + x
        first[cell[i] + 1] += 1
    first = np.cumsum(first)
    free = first[:-1].copy()
    order = np.empty(len(points), np.int64)
    for i in range(len(points)):
        order[free[cell[i]]] = i
        free[cell[i]] += 1
    return first, order


@njit(cache=True, nogil=True)
def _mutual(
    points: NDArray[np.float32],
    predicted: NDArray[np.float32],
    stretch: float,
    words: NDArray[np.uint64],
    others: NDArray[np.float32],
    other_words: NDArray[np.uint64],
    first: NDArray[np.int64],
    order: NDArray[np.int64],
    columns: int,
    rows: int,
) -> int:
    far = HAMMING_MAX + 1
    nearest = np.full(len(points), -1, np.int64)
    nearest_back = np.full(len(others), -1, np.int64)
    distance_back = np.full(len(others), far, np.int64)
    for i in range(len(points)):
        dx = (predicted[i, 0] - points[i, 0]) * stretch
        dy = (predicted[i, 1] - points[i, 1]) * stretch
        if math.isnan(dx):
            continue
        x, y = points[i, 0] + dx, points[i, 1] + dy
        r = min(RADIUS_PX + RADIUS_OF_FLOW * math.sqrt(dx * dx + dy * dy), LARGEST_RADIUS_PX)
        if not (-r <= x < columns * _CELL_PX + r and -r <= y < rows * _CELL_PX + r):
            continue
        x0, x1 = max(int((x - r) // _CELL_PX), 0), min(int((x + r) // _CELL_PX), columns - 1)
        y0, y1 = max(int((y - r) // _CELL_PX), 0), min(int((y + r) // _CELL_PX), rows - 1)
        best = far
        for cell_row in range(y0, y1 + 1):
            begin, end = first[cell_row * columns + x0], first[cell_row * columns + x1 + 1]
            for k in range(begin, end):
                j = order[k]
                u, v = others[j, 0] - x, others[j, 1] - y
                if u * u + v * v > r * r:
                    continue
                distance = int(
                    _population_count(words[i, 0] ^ other_words[j, 0])
                    + _population_count(words[i, 1] ^ other_words[j, 1])
                    + _population_count(words[i, 2] ^ other_words[j, 2])
                    + _population_count(words[i, 3] ^ other_words[j, 3])
                )
                if distance < best:
                    best, nearest[i] = distance, j
                if distance < distance_back[j]:
                    distance_back[j], nearest_back[j] = distance, i
    count = 0
    for i in range(len(points)):
        if nearest[i] >= 0 and nearest_back[nearest[i]] == i:
            count += 1
    return count
