"""Motion blur of one rendered view, by following the depth flow."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics
from rig.drivers.scenes.trajectories import Pose, Vector

Floats = NDArray[np.float32]

_MOST_STEPS = 96
_SHORTEST_PX = 1e-3
_DARKEST_CD_M2 = 1e-6


def flow_blur(
    radiance: Floats, grey: Floats, depth_m: Floats, lens: Intrinsics, start: Pose, end: Pose
) -> Floats:
    """Return the mean of a view while the camera moves from `start` to `end`.

    `radiance`, `grey` and `depth_m` (H x W) were rendered at `start`.
    Each pixel averages the grey picture along the way back to where its surface was at `start`,
    evenly in time, and keeps its own channel's share. The surface is taken to be as far away at
    the end as the depth at `start` says, which holds along roads and walls; occlusions are not
    re-rendered.
    """
    turn = start.rotation @ end.rotation.T
    shift = start.rotation @ (end.centre - start.centre)
    out = np.empty_like(radiance)
    _gather(radiance, grey, depth_m, lens.fx_px, lens.cx_px, lens.cy_px, turn, shift, out)
    return out


@nb.njit(parallel=True, cache=True, fastmath=True, nogil=True, error_model="numpy")
def _gather(
    radiance: Floats,
    grey: Floats,
    depth_m: Floats,
    f: float,
    cx: float,
    cy: float,
    turn: Vector,
    shift: Vector,
    out: Floats,
) -> None:
    height, width = grey.shape
    for row in nb.prange(height):
        y = int(np.int64(row))
        for x in range(width):
            z = depth_m[y, x]
            X = (x - cx) / f * z
            Y = (y - cy) / f * z
            a = turn[0, 0] * X + turn[0, 1] * Y + turn[0, 2] * z + shift[0]
            b = turn[1, 0] * X + turn[1, 1] * Y + turn[1, 2] * z + shift[1]
            c = max(turn[2, 0] * X + turn[2, 1] * Y + turn[2, 2] * z + shift[2], 0.05)
            dx = a / c * f + cx - x
            dy = b / c * f + cy - y
            colour = radiance[y, x] / max(grey[y, x], _DARKEST_CD_M2)
            out[y, x] = colour * _mean_along(grey, x, y, dx, dy, c / z)


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _mean_along(grey: Floats, x: int, y: int, dx: float, dy: float, far: float) -> float:
    """Return the mean over time of a picture along the line from (x, y) to (x + dx, y + dy).

    `far` is the depth at the line's end over that at its begin: what comes nearer moves faster.
    A step goes from pixel to pixel along the longer axis and blends two pixels along the other
    one only, which keeps the picture sharper than blending four.
    """
    length = max(abs(dx), abs(dy))
    if length < _SHORTEST_PX:
        return float(grey[y, x])
    cell = max(1.0, length / _MOST_STEPS)
    last = int(length / cell + 0.5)
    along_x = abs(dx) >= abs(dy)
    total = 0.0
    before = 0.0
    low = 0.0
    for n in range(last + 1):
        high = min((n + 0.5) * cell / length, 1.0)
        after = high / (far - high * (far - 1.0))
        middle = 0.5 * (low + high)
        whole = n * cell / length
        if along_x:
            value = _blend(grey, y + middle * dy, math.floor(x + whole * dx + 0.5), True)
        else:
            value = _blend(grey, x + middle * dx, math.floor(y + whole * dy + 0.5), False)
        total += value * (after - before)
        before = after
        low = high
    return total


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy", inline="always")
def _blend(grey: Floats, across: float, at: int, along_x: bool) -> float:
    """Return the picture between two pixels of a column (`along_x`) or of a row."""
    height, width = grey.shape
    if along_x:
        x = min(max(at, 0), width - 1)
        v = min(max(across, 0.0), height - 1.001)
        iy = int(v)
        q = v - iy
        return float(grey[iy, x] * (1 - q) + grey[iy + 1, x] * q)
    y = min(max(at, 0), height - 1)
    u = min(max(across, 0.0), width - 1.001)
    ix = int(u)
    p = u - ix
    return float(grey[y, ix] * (1 - p) + grey[y, ix + 1] * p)
