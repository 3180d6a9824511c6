"""Motion blur of one rendered view, by following the depth flow."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics
from rig.drivers.scenes.trajectories import Pose, Vector

Floats = NDArray[np.float32]

_LONGEST_STEPS = 96
_STEP_PX = 1.0
_DARKEST_CD_M2 = 1e-6


def flow_blur(
    radiance: Floats, ratio: Floats, depth_m: Floats, lens: Intrinsics, start: Pose, end: Pose
) -> Floats:
    """Return the mean of a view while the camera moves from `start` to `end`.

    `radiance` and `depth_m` (H x W) were rendered at `start`; `ratio` is `channel_ratio(radiance)`.
    Each pixel averages the grey picture along the displacement of the surface that it shows, and
    keeps its own channel's share; occlusions are not re-rendered.
    """
    turn = end.rotation @ start.rotation.T
    shift = end.rotation @ (start.centre - end.centre)
    out = np.empty_like(radiance)
    _gather(radiance / ratio, ratio, depth_m, lens.fx_px, lens.cx_px, lens.cy_px, turn, shift, out)
    return out


@nb.njit(parallel=True, cache=True, fastmath=True, nogil=True)
def channel_ratio(radiance: Floats) -> Floats:
    """Return what each Bayer pixel's channel has over the local grey (R/4 + G/2 + B/4), H x W.

    Both are means over the pixel and its eight nearest neighbours of the same channel.
    """
    height, width = radiance.shape
    grey = np.empty_like(radiance)
    for y in nb.prange(height):
        up = y - 1 if y > 0 else 1
        down = y + 1 if y < height - 1 else height - 2
        for x in range(width):
            left = x - 1 if x > 0 else 1
            right = x + 1 if x < width - 1 else width - 2
            beside = radiance[up, x] + radiance[down, x] + radiance[y, left] + radiance[y, right]
            corners = (radiance[up, left] + radiance[up, right] + radiance[down, left]) + radiance[
                down, right
            ]
            grey[y, x] = (4 * radiance[y, x] + 2 * beside + corners) / 16
    ratio = np.empty_like(radiance)
    for row in nb.prange(height):
        y = int(np.int64(row))  # a parallel index is unsigned: y - 2 would be a float
        for x in range(width):
            own = 0.0
            all_channels = 0.0
            for j in range(-2, 3, 2):
                yy = y + j if 0 <= y + j < height else y
                for i in range(-2, 3, 2):
                    xx = x + i if 0 <= x + i < width else x
                    own += radiance[yy, xx]
                    all_channels += grey[yy, xx]
            ratio[y, x] = max(own, _DARKEST_CD_M2) / max(all_channels, _DARKEST_CD_M2)
    return ratio


@nb.njit(parallel=True, cache=True, fastmath=True, nogil=True)
def _gather(
    grey: Floats,
    ratio: Floats,
    depth_m: Floats,
    f: float,
    cx: float,
    cy: float,
    turn: Vector,
    shift: Vector,
    out: Floats,
) -> None:
    height, width = grey.shape
    for y in nb.prange(height):
        for x in range(width):
            z = depth_m[y, x]
            X = (x - cx) / f * z
            Y = (y - cy) / f * z
            a = turn[0, 0] * X + turn[0, 1] * Y + turn[0, 2] * z + shift[0]
            b = turn[1, 0] * X + turn[1, 1] * Y + turn[1, 2] * z + shift[1]
            c = max(turn[2, 0] * X + turn[2, 1] * Y + turn[2, 2] * z + shift[2], 0.05)
            dx = a / c * f + cx - x
            dy = b / c * f + cy - y
            length = math.sqrt(dx * dx + dy * dy)
            steps = int(min(max(math.ceil(length / _STEP_PX), 1), _LONGEST_STEPS))
            total = 0.0
            for i in range(steps):
                k = (i + 0.5) / steps
                u = min(max(x - k * dx, 0.0), width - 1.001)
                v = min(max(y - k * dy, 0.0), height - 1.001)
                ix = int(u)
                iy = int(v)
                p = u - ix
                q = v - iy
                top = grey[iy, ix] * (1 - p) + grey[iy, ix + 1] * p
                low = grey[iy + 1, ix] * (1 - p) + grey[iy + 1, ix + 1] * p
                total += top * (1 - q) + low * q
            out[y, x] = ratio[y, x] * total / steps
