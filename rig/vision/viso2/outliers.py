"""Matches that move unlike their neighbours are wrong."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rig.vision.viso2.delaunay import triangulate

TOLERANCE_PX = 5
"""Two neighbours support each other when their flows differ by less, in x and y together."""

SUPPORT_MIN = 4
"""Each triangle beside an edge counts it, so 4 are two neighbours that agree."""


def supported(previous_px: NDArray[np.int32], current_px: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return which of N matches (N x 2 points each) at least two neighbours agree with.

    Neighbours are joined by the Delaunay triangulation of the current points, and the edges of
    every triangle are looked at, so that one inside the net counts twice (StereoScan: a match is
    kept when at least two neighbours support it). Points on a line support nothing.
    """
    triangles = triangulate(current_px)
    return np.asarray(_support(triangles, previous_px - current_px)) >= SUPPORT_MIN


@njit(cache=True, nogil=True)
def _support(triangles: NDArray[np.int32], flow_px: NDArray[np.int32]) -> NDArray[np.int32]:
    support = np.zeros(len(flow_px), np.int32)
    for triangle in range(len(triangles)):
        for k in range(3):
            a, b = triangles[triangle, k], triangles[triangle, (k + 1) % 3]
            difference = abs(flow_px[a, 0] - flow_px[b, 0]) + abs(flow_px[a, 1] - flow_px[b, 1])
            if difference < TOLERANCE_PX:
                support[a] += 1
                support[b] += 1
    return support
