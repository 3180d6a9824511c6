"""Motion blur of one rendered view, by following the depth flow."""

from __future__ import annotations

from collections.abc import Sequence

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics
from rig.drivers.scenes.trajectories import Pose

Floats = NDArray[np.float32]

_REACH_PX = 4
"""Of the interpolation, to either side."""
_HALFWAY = (1225 / 2048, -245 / 2048, 49 / 2048, -5 / 2048)
"""Lagrange's weights of the next, second, third and fourth pixel for a place halfway."""
_CREST = 1 / 12
"""Of the second difference: how much lower than a curve its chord lies on average."""
_BETWEEN = tuple(
    np.float32((1 + 2 * _CREST) * near - far)
    for near, far in zip(_HALFWAY, (_CREST, 0, 0, 0), strict=True)
)
_UPON = tuple(
    np.float32(own - _CREST * (near + far))
    for own, near, far in zip(
        (1 + 2 * _CREST, 0, 0, 0, 0), (_HALFWAY[0], *_HALFWAY), (*_HALFWAY, 0), strict=True
    )
)
_DARKEST_SHARE = np.float32(0.75)
"""Of the darkest pixel nearby: an interpolated curve swings no lower beside a lamp."""
_PARTS = 256
"""Of a pixel of the finer picture: places are rounded to them, so that rounding blurs nothing."""
_PART = np.float32(1 / _PARTS)
_STILL_PX = np.float32(1 / 256)
"""Less motion than this leaves a pixel as it is."""
_TAPS_PER_PX = np.float32(2.0)
_MOST_TAPS = 20
"""Of one piece of the way; longer pieces are sampled more coarsely."""
_DARKEST_CD_M2 = np.float32(1e-6)
_NEAREST_M = np.float32(0.05)


def flow_blur(
    radiance: Floats, grey: Floats, depth_m: Floats, lens: Intrinsics, poses: Sequence[Pose]
) -> Floats:
    """Return the mean of a view while the camera moves through `poses`, evenly spaced in time.

    `radiance`, `grey` and `depth_m` (H x W) were rendered at the first of at least two poses.
    Each pixel averages the grey picture along the way back to where its surface was at the start,
    straight and even from pose to pose, and keeps its own channel's share. The surface is taken to
    be as far away throughout as the depth at the start says, which holds along roads and walls;
    occlusions are not re-rendered.
    """
    start = poses[0]
    turns = [start.rotation @ pose.rotation.T for pose in poses[1:]]
    shifts = [start.rotation @ (pose.centre - start.centre) for pose in poses[1:]]
    flows = np.array([np.column_stack(flow) for flow in zip(turns, shifts, strict=True)])
    height, width = grey.shape
    fine = np.empty((2 * height, 2 * width), np.float32)
    _refine(np.pad(grey, _REACH_PX, mode="edge"), fine)
    out = np.empty_like(radiance)
    camera = (np.float32(lens.fx_px), np.float32(lens.cx_px), np.float32(lens.cy_px))
    _gather(radiance, grey, fine, depth_m, camera, flows.astype(np.float32), out)
    return out


@nb.njit(parallel=True, cache=True, fastmath=True, nogil=True, error_model="numpy")
def _refine(wide: Floats, fine: Floats) -> None:
    """Make a picture, with `_REACH_PX` more around it, twice as fine.

    Its pixels are raised so that straight lines between them lie as high as the curve on average.
    """
    width = fine.shape[1] // 2
    for turn in nb.prange(fine.shape[0]):
        row = np.int64(turn)
        top = row // 2 + _REACH_PX
        line = np.empty(wide.shape[1], np.float32)
        for x in range(line.size):
            column = wide[top - 4 : top + 5, x]
            line[x] = _between(column[1:]) if row % 2 else _upon(column)
        out = fine[row]
        for x in range(width):
            at = x + _REACH_PX
            out[2 * x] = _upon(line[at - 4 : at + 5])
            out[2 * x + 1] = _between(line[at - 3 : at + 5])


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy", inline="always")
def _upon(p: Floats) -> np.float32:
    """Return the value at the middle one of nine pixels, not far below the lowest of three."""
    w = _UPON
    value = w[0] * p[4] + w[1] * (p[3] + p[5]) + w[2] * (p[2] + p[6])
    value += w[3] * (p[1] + p[7]) + w[4] * (p[0] + p[8])
    return max(value, _DARKEST_SHARE * min(p[4], min(p[3], p[5])))


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy", inline="always")
def _between(p: Floats) -> np.float32:
    """Return the value between the middle two of eight pixels, not far below the lowest of four."""
    w = _BETWEEN
    value = w[0] * (p[3] + p[4]) + w[1] * (p[2] + p[5]) + w[2] * (p[1] + p[6])
    value += w[3] * (p[0] + p[7])
    return max(value, _DARKEST_SHARE * min(min(p[2], p[3]), min(p[4], p[5])))


@nb.njit(parallel=True, cache=True, fastmath=True, nogil=True, error_model="numpy")
def _gather(
    radiance: Floats,
    grey: Floats,
    fine: Floats,
    depth_m: Floats,
    camera: tuple[np.float32, np.float32, np.float32],
    flows: Floats,
    out: Floats,
) -> None:
    height, width = grey.shape
    f, cx, cy = camera
    pieces = flows.shape[0]
    for row in nb.prange(height):
        y = np.float32(np.int64(row))
        for column in range(width):
            x = np.float32(column)
            z = depth_m[row, column]
            X = (x - cx) / f * z
            Y = (y - cy) / f * z
            from_x = x
            from_y = y
            total = np.float32(0.0)
            moved = np.float32(0.0)
            for k in range(pieces):
                m = flows[k]
                a = m[0, 0] * X + m[0, 1] * Y + m[0, 2] * z + m[0, 3]
                b = m[1, 0] * X + m[1, 1] * Y + m[1, 2] * z + m[1, 3]
                c = m[2, 0] * X + m[2, 1] * Y + m[2, 2] * z + m[2, 3]
                per_depth = f / max(c, _NEAREST_M)
                to_x = a * per_depth + cx
                to_y = b * per_depth + cy
                total += _mean_along(fine, from_x, from_y, to_x - from_x, to_y - from_y)
                from_x = to_x
                from_y = to_y
                moved = max(moved, max(abs(to_x - x), abs(to_y - y)))
            if moved < _STILL_PX:
                out[row, column] = radiance[row, column]
                continue
            colour = radiance[row, column] / max(grey[row, column], _DARKEST_CD_M2)
            out[row, column] = colour * total / np.float32(pieces)


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy", inline="always")
def _mean_along(
    fine: Floats, x: np.float32, y: np.float32, dx: np.float32, dy: np.float32
) -> np.float32:
    """Return the mean of a picture along the line from (x, y) to (x + dx, y + dy).

    `fine` has two pixels for one of the picture; beyond its border lies what is on the border.
    """
    length = max(abs(dx), abs(dy))
    taps = np.int64(min(np.float32(1.0) + length * _TAPS_PER_PX, np.float32(_MOST_TAPS)))
    per_tap = np.float32(2 * _PARTS) / np.float32(taps)
    step_x = dx * per_tap
    step_y = dy * per_tap
    right = np.float32((fine.shape[1] - 2) * _PARTS)
    bottom = np.float32((fine.shape[0] - 2) * _PARTS)
    u = np.float32(2 * _PARTS) * x + np.float32(0.5) * step_x + np.float32(0.5)
    v = np.float32(2 * _PARTS) * y + np.float32(0.5) * step_y + np.float32(0.5)
    total = np.float32(0.0)
    for _ in range(taps):
        at_x = np.uint32(min(max(u, np.float32(0.0)), right))
        at_y = np.uint32(min(max(v, np.float32(0.0)), bottom))
        ix = at_x // np.uint32(_PARTS)
        iy = at_y // np.uint32(_PARTS)
        p = np.float32(at_x % np.uint32(_PARTS)) * _PART
        q = np.float32(at_y % np.uint32(_PARTS)) * _PART
        below = iy + np.uint32(1)
        upper = fine[iy, ix] + p * (fine[iy, ix + np.uint32(1)] - fine[iy, ix])
        lower = fine[below, ix] + p * (fine[below, ix + np.uint32(1)] - fine[below, ix])
        total += upper + q * (lower - upper)
        u += step_x
        v += step_y
    return total / np.float32(taps)
