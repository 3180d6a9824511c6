"""Motion blur of one rendered view, by following the depth flow."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics
from rig.drivers.scenes.trajectories import Pose, Vector

_LONGEST_STEPS = 96
_STEP_PX = 1.0


def flow_blur(
    radiance: NDArray[np.float32],
    depth_m: NDArray[np.float32],
    lens: Intrinsics,
    start: Pose,
    end: Pose,
) -> NDArray[np.float32]:
    """Return the mean of a view while the camera moves from `start` to `end`.

    `radiance` and `depth_m` (H x W) were rendered at `start`. Each pixel averages the picture
    along the displacement of the surface that it shows, from pixels of its own Bayer channel;
    occlusions are not re-rendered.
    """
    turn = end.rotation @ start.rotation.T
    shift = end.rotation @ (start.centre - end.centre)
    out = np.empty_like(radiance)
    _gather(radiance, depth_m, lens.fx_px, lens.cx_px, lens.cy_px, turn, shift, out)
    return out


@nb.njit(parallel=True, cache=True, fastmath=True, nogil=True)
def _gather(
    radiance: NDArray[np.float32],
    depth_m: NDArray[np.float32],
    f: float,
    cx: float,
    cy: float,
    turn: Vector,
    shift: Vector,
    out: NDArray[np.float32],
) -> None:
    height, width = radiance.shape
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
            last_x = width - 1 - ((width - 1 - x) & 1)
            last_y = height - 1 - ((height - 1 - y) & 1)
            total = 0.0
            for i in range(steps):
                k = (i + 0.5) / steps
                u = -0.5 * k * dx
                v = -0.5 * k * dy
                fu = math.floor(u)
                fv = math.floor(v)
                p = u - fu
                q = v - fv
                x0 = min(max(x + 2 * int(fu), x & 1), last_x)
                x1 = min(max(x + 2 * int(fu) + 2, x & 1), last_x)
                y0 = min(max(y + 2 * int(fv), y & 1), last_y)
                y1 = min(max(y + 2 * int(fv) + 2, y & 1), last_y)
                top = radiance[y0, x0] * (1 - p) + radiance[y0, x1] * p
                low = radiance[y1, x0] * (1 - p) + radiance[y1, x1] * p
                total += top * (1 - q) + low * q
            out[y, x] = total / steps
