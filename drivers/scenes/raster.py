"""A rasteriser for lit, textured quads: linear radiance and depth of one pinhole view.

Quads that no pixel can see are dropped first; the others are entered into a depth buffer, the near
ones first, and only what is left visible is shaded, once.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics
from rig.drivers.scenes.geometry import CUTOUT, Surfaces
from rig.drivers.scenes.sampling import RUN_PX, SCRATCH_SIZE
from rig.drivers.scenes.scene import FAR_M
from rig.drivers.scenes.shading import add_sky, add_surface, opaque
from rig.drivers.scenes.textures import Atlas
from rig.drivers.scenes.trajectories import Pose, Vector

Floats = NDArray[np.float32]
Wholes = NDArray[np.int64]

_NEAR_M = 0.12
_BAND_ROWS = 16
_JITTER_PX = 0.25
_WEIGHT = 0.5
"""Of each of the two samples, which lie up to the left and down to the right of the middle."""


def render(
    surfaces: Surfaces, atlas: Atlas, light_lux: Floats, sky: Floats, lens: Intrinsics, pose: Pose
) -> tuple[Floats, Floats, Floats]:
    """Return radiance (cd/m2, each pixel in its Bayer channel, RGGB), the same in grey, and depth.

    All are H x W; grey is R/4 + G/2 + B/4, depth is in metres. Two samples a pixel; the depth is
    that of the first. `light_lux` holds the baked illuminance of every surface, laid out by
    `surfaces.light_table`.
    """
    radiance = np.zeros((lens.height_px, lens.width_px), np.float32)
    grey = np.zeros_like(radiance)
    depth_m = np.empty_like(radiance)
    camera = (lens.fx_px, lens.cx_px, lens.cy_px)
    quads, nearest_m, to_surface, edges = _project(
        surfaces, pose.rotation, pose.centre, camera, radiance.shape
    )
    order = np.argsort(nearest_m, kind="stable")
    _draw(
        to_surface[order],
        edges[order],
        surfaces.paint[quads[order]],
        atlas.texels,
        atlas.table,
        light_lux,
        sky,
        pose.rotation,
        camera,
        radiance,
        grey,
        depth_m,
    )
    return radiance, grey, depth_m


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _project(
    surfaces: Surfaces,
    rotation: Vector,
    eye: Vector,
    camera: tuple[float, float, float],
    shape: tuple[int, int],
) -> tuple[Wholes, Vector, Vector, Vector]:
    """Return the quads in view: number, nearest depth, homography and outline.

    The homography, 9 numbers, takes a pixel to metres along the quad's two edges; its third row
    is 1/depth. An outline is up to 8 edges (top and bottom row, column at the first, slope).
    """
    f, cx, cy = camera
    count = surfaces.corners.shape[0]
    quads = np.empty(count, np.int64)
    nearest_m = np.empty(count)
    to_surface = np.empty((count, 9))
    edges = np.zeros((count, 8, 4))
    cam = np.empty((4, 3))
    outline = np.empty((8, 2))
    seen = 0
    for q in range(count):
        for i in range(4):
            for r in range(3):
                cam[i, r] = (
                    rotation[r, 0] * (surfaces.corners[q, i, 0] - eye[0])
                    + rotation[r, 1] * (surfaces.corners[q, i, 1] - eye[1])
                    + rotation[r, 2] * (surfaces.corners[q, i, 2] - eye[2])
                )
        if _out_of_view(cam, f, cx, cy, shape):
            continue
        if not _homography(cam, surfaces.length_m[q], f, cx, cy, to_surface[seen]):
            continue
        sides, nearest_m[seen] = _clip(cam, f, cx, cy, outline)
        for i in range(sides):
            j = i + 1 if i + 1 < sides else 0
            x0, y0 = outline[i]
            x1, y1 = outline[j]
            if y0 != y1:
                edges[seen, i, 0] = y0
                edges[seen, i, 1] = y1
                edges[seen, i, 2] = x0
                edges[seen, i, 3] = (x1 - x0) / (y1 - y0)
        quads[seen] = q
        seen += 1
    return quads[:seen], nearest_m[:seen], to_surface[:seen], edges[:seen]


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy", inline="always")
def _out_of_view(cam: Vector, f: float, cx: float, cy: float, shape: tuple[int, int]) -> bool:
    """Return whether all corners lie behind the camera or beyond one side of the picture."""
    height, width = shape
    behind = left = right = above = below = True
    for i in range(4):
        x, y, z = cam[i]
        behind &= z < _NEAR_M
        left &= f * x + (cx + 1) * z < 0
        right &= f * x + (cx - width) * z > 0
        above &= f * y + (cy + 1) * z < 0
        below &= f * y + (cy - height) * z > 0
    return behind or left or right or above or below


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy", inline="always")
def _homography(cam: Vector, length_m: Vector, f: float, cx: float, cy: float, out: Vector) -> bool:
    """Invert the frame of edges and corner; False for a quad that is seen edge on."""
    a = (cam[1] - cam[0]) / length_m[0]
    b = (cam[3] - cam[0]) / length_m[1]
    o = cam[0]
    rows = (np.cross(b, o), np.cross(o, a), np.cross(a, b))
    volume = rows[2][0] * o[0] + rows[2][1] * o[1] + rows[2][2] * o[2]
    if abs(volume) < 1e-9:
        return False
    for k in range(3):
        per_x = rows[k][0] / (f * volume)
        per_y = rows[k][1] / (f * volume)
        out[3 * k] = per_x
        out[3 * k + 1] = per_y
        out[3 * k + 2] = rows[k][2] / volume - per_x * cx - per_y * cy
    return True


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy", inline="always")
def _clip(cam: Vector, f: float, cx: float, cy: float, outline: Vector) -> tuple[int, float]:
    """Clip a quad to the near plane and project it; return its sides and its nearest depth."""
    k = 0
    nearest_m = 1e9
    for i in range(4):
        j = (i + 1) & 3
        za = cam[i, 2]
        zb = cam[j, 2]
        if za >= _NEAR_M:
            outline[k, 0] = cam[i, 0] / za * f + cx
            outline[k, 1] = cam[i, 1] / za * f + cy
            nearest_m = min(nearest_m, za)
            k += 1
        if (za >= _NEAR_M) != (zb >= _NEAR_M):
            t = (_NEAR_M - za) / (zb - za)
            x = cam[i, 0] + t * (cam[j, 0] - cam[i, 0])
            y = cam[i, 1] + t * (cam[j, 1] - cam[i, 1])
            outline[k, 0] = x / _NEAR_M * f + cx
            outline[k, 1] = y / _NEAR_M * f + cy
            nearest_m = _NEAR_M
            k += 1
    return k, nearest_m


@nb.njit(parallel=True, cache=True, fastmath=True, nogil=True, error_model="numpy")
def _draw(
    to_surface: Vector,
    edges: Vector,
    paint: Vector,
    texels: Floats,
    table: Wholes,
    light: Floats,
    sky: Floats,
    rotation: Vector,
    camera: tuple[float, float, float],
    radiance: Floats,
    grey: Floats,
    depth_m: Floats,
) -> None:
    """Draw in bands of fixed height, so that the result does not depend on the threads.

    Neighbouring bands go to different threads, as the top of a picture is often cheap sky.
    """
    height, width = radiance.shape
    bands = (height + _BAND_ROWS - 1) // _BAND_ROWS
    stride = _coprime_stride(bands)
    for turn in nb.prange(bands):
        top = np.int64(turn) * stride % bands * _BAND_ROWS
        rows = min(_BAND_ROWS, height - top)
        best = np.empty((rows, width), np.float32)
        owner = np.empty((rows, width), np.int32)
        scratch = np.empty(SCRATCH_SIZE)
        for shift_px in (-_JITTER_PX, _JITTER_PX):
            best[:] = 0
            owner[:] = -1
            for q in range(to_surface.shape[0]):
                _cover(
                    q, top, shift_px, to_surface[q], edges[q], paint[q], texels, table, best, owner
                )
            for row in range(rows):
                _shade(
                    top + row,
                    shift_px,
                    owner[row],
                    to_surface,
                    paint,
                    texels,
                    table,
                    light,
                    sky,
                    rotation,
                    camera,
                    scratch,
                    radiance[top + row],
                    grey[top + row],
                )
            if shift_px < 0:
                for row in range(rows):
                    _keep_depth(top + row, shift_px, owner[row], to_surface, depth_m[top + row])


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _coprime_stride(count: int) -> int:
    """Return a step near the golden section that visits every number below `count` once."""
    stride = max(int(0.618 * count), 1)
    while math.gcd(stride, count) > 1:
        stride += 1
    return stride


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _cover(
    q: int,
    top: int,
    shift_px: float,
    to_surface: Vector,
    edges: Vector,
    paint: Vector,
    texels: Floats,
    table: Wholes,
    best: Floats,
    owner: NDArray[np.int32],
) -> None:
    """Enter one quad into a band's depth buffer, row by row; pixels are shifted both ways."""
    rows, width = best.shape
    low = 1e9
    high = -1e9
    for i in range(8):
        if edges[i, 0] != edges[i, 1]:
            low = min(low, edges[i, 0], edges[i, 1])
            high = max(high, edges[i, 0], edges[i, 1])
    first = max(top, math.ceil(low + shift_px))
    last = min(top + rows - 1, math.floor(high + shift_px))
    cut = paint[CUTOUT] >= 0
    for row in range(first, last + 1):
        y = row - shift_px
        left = 1e9
        right = -1e9
        for i in range(8):
            if (edges[i, 0] <= y) != (edges[i, 1] <= y):
                x = edges[i, 2] + (y - edges[i, 0]) * edges[i, 3]
                left = min(left, x)
                right = max(right, x)
        start = max(0, math.ceil(max(left + shift_px, -1.0)))
        stop = min(width, math.ceil(min(right + shift_px, width + 1.0)))
        if start >= stop:
            continue
        nearest = best[row - top, start:stop]
        who = owner[row - top, start:stop]
        at_start = to_surface[6] * (start - shift_px) + to_surface[7] * y + to_surface[8]
        if cut:
            for i in range(nearest.size):
                closeness = np.float32(at_start + to_surface[6] * i)
                if closeness > nearest[i] and opaque(
                    start + i - shift_px, y, to_surface, paint, texels, table
                ):
                    nearest[i] = closeness
                    who[i] = q
        else:
            first_closeness = np.float32(at_start)
            step = np.float32(to_surface[6])
            me = np.int32(q)
            for i in range(nearest.size):
                closeness = first_closeness + step * np.float32(np.int32(i))
                nearer = closeness > nearest[i]
                who[i] = me if nearer else who[i]
                nearest[i] = closeness if nearer else nearest[i]


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _shade(
    y: int,
    shift_px: float,
    owner: NDArray[np.int32],
    to_surface: Vector,
    paint: Vector,
    texels: Floats,
    table: Wholes,
    light: Floats,
    sky: Floats,
    rotation: Vector,
    camera: tuple[float, float, float],
    scratch: Vector,
    row: Floats,
    grey: Floats,
) -> None:
    """Add one sample to every pixel of a row, one run of pixels of the same owner at a time."""
    f, cx, cy = camera
    start = 0
    while start < row.size:
        q = owner[start]
        stop = start + 1
        last = min(row.size, start + RUN_PX)
        while stop < last and owner[stop] == q:
            stop += 1
        channels = ((start & 1) + (y & 1), ((start + 1) & 1) + (y & 1))
        x = start - shift_px
        run = row[start:stop]
        if q < 0:
            ray = ((x - cx) / f, (y - shift_px - cy) / f, 1 / f)
            add_sky(sky, rotation, ray, channels, _WEIGHT, run, grey[start:stop])
        else:
            add_surface(
                to_surface[q],
                paint[q],
                x,
                y - shift_px,
                channels,
                _WEIGHT,
                texels,
                table,
                light,
                scratch,
                run,
                grey[start:stop],
            )
        start = stop


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _keep_depth(
    y: int, shift_px: float, owner: NDArray[np.int32], to_surface: Vector, row: Floats
) -> None:
    for x in range(row.size):
        q = owner[x]
        row[x] = FAR_M
        if q >= 0:
            h = to_surface[q]
            at = h[6] * (x - shift_px) + h[7] * (y - shift_px) + h[8]
            row[x] = min(1.0 / at, FAR_M)
