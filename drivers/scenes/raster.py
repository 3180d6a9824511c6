"""A rasteriser for lit, textured quads: linear radiance and depth of one pinhole view."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics
from rig.drivers.scenes.geometry import Surfaces
from rig.drivers.scenes.shading import CUTOUT, opaque, paint_table, sky_radiance, surface_radiance
from rig.drivers.scenes.textures import Atlas
from rig.drivers.scenes.trajectories import Pose, Vector

Floats = NDArray[np.float32]

FAR_M = 2000.0
"""The depth of the sky."""

_NEAR_M = 0.12
_BAND_ROWS = 48
_JITTER_PX = ((-0.25, -0.25), (0.25, 0.25))


def render(
    surfaces: Surfaces, atlas: Atlas, light_lux: Floats, sky: Floats, lens: Intrinsics, pose: Pose
) -> tuple[Floats, Floats]:
    """Return radiance (cd/m2, each pixel in its Bayer channel, RGGB) and depth (metres).

    Both are H x W. Two samples a pixel; the depth is that of the first. `light_lux` holds the
    baked illuminance of every surface, laid out by `surfaces.light_table`.
    """
    radiance = np.zeros((lens.height_px, lens.width_px), np.float32)
    depth_m = np.full_like(radiance, FAR_M)
    paint = paint_table(surfaces)
    for sample, jitter in enumerate(_JITTER_PX):
        centre = (lens.cx_px + jitter[0], lens.cy_px + jitter[1])
        polygons, sides, inverse_z, nearest = _project(
            surfaces, pose.rotation, pose.centre, lens.fx_px, *centre
        )
        to_surface = _pixel_to_surface(surfaces, pose, lens.fx_px, centre, sides)
        order = np.argsort(np.where(sides >= 3, nearest, np.inf), kind="stable")
        _draw(
            order[: int((sides >= 3).sum())],
            polygons,
            sides,
            inverse_z,
            to_surface,
            paint,
            atlas.texels,
            atlas.table,
            light_lux,
            sky,
            pose.rotation,
            lens.fx_px,
            *centre,
            1.0 / len(_JITTER_PX),
            sample == 0,
            radiance,
            depth_m,
        )
    return radiance, depth_m


def _pixel_to_surface(
    surfaces: Surfaces, pose: Pose, f: float, centre: tuple[float, float], sides: NDArray[np.int64]
) -> Vector:
    """Return per quad the homography from a pixel to metres along its two edges."""
    columns = (
        surfaces.along_a / surfaces.length_m[:, :1],
        surfaces.along_b / surfaces.length_m[:, 1:],
        surfaces.origin - pose.centre,
    )
    frames = np.stack([column @ pose.rotation.T for column in columns], 2)
    edge_on = np.abs(np.linalg.det(frames)) < 1e-9
    sides[edge_on] = 0
    frames[edge_on] = np.eye(3)
    ray = np.array([[1 / f, 0, -centre[0] / f], [0, 1 / f, -centre[1] / f], [0, 0, 1]])
    return np.asarray(np.linalg.inv(frames) @ ray)


@nb.njit(cache=True, nogil=True)
def _project(
    surfaces: Surfaces, rotation: Vector, eye: Vector, f: float, cx: float, cy: float
) -> tuple[Vector, NDArray[np.int64], Vector, Vector]:
    """Clip each quad to the near plane and project it; 1/z is affine in the pixel."""
    count = surfaces.corners.shape[0]
    polygons = np.zeros((count, 8, 2))
    sides = np.zeros(count, np.int64)
    inverse_z = np.zeros((count, 3))
    nearest = np.zeros(count)
    for q in range(count):
        cam = np.empty((4, 3))
        for i in range(4):
            for r in range(3):
                cam[i, r] = (
                    rotation[r, 0] * (surfaces.corners[q, i, 0] - eye[0])
                    + rotation[r, 1] * (surfaces.corners[q, i, 1] - eye[1])
                    + rotation[r, 2] * (surfaces.corners[q, i, 2] - eye[2])
                )
        a = cam[1] - cam[0]
        b = cam[3] - cam[0]
        n0 = a[1] * b[2] - a[2] * b[1]
        n1 = a[2] * b[0] - a[0] * b[2]
        n2 = a[0] * b[1] - a[1] * b[0]
        distance = n0 * cam[0, 0] + n1 * cam[0, 1] + n2 * cam[0, 2]
        if abs(distance) < 1e-9:
            continue
        inverse_z[q, 0] = n0 / (f * distance)
        inverse_z[q, 1] = n1 / (f * distance)
        inverse_z[q, 2] = n2 / distance - inverse_z[q, 0] * cx - inverse_z[q, 1] * cy
        k = 0
        closest = 1e9
        for i in range(4):
            j = (i + 1) & 3
            za = cam[i, 2]
            zb = cam[j, 2]
            if za >= _NEAR_M:
                polygons[q, k, 0] = cam[i, 0] / za * f + cx
                polygons[q, k, 1] = cam[i, 1] / za * f + cy
                closest = min(closest, za)
                k += 1
            if (za >= _NEAR_M) != (zb >= _NEAR_M):
                t = (_NEAR_M - za) / (zb - za)
                x = cam[i, 0] + t * (cam[j, 0] - cam[i, 0])
                y = cam[i, 1] + t * (cam[j, 1] - cam[i, 1])
                polygons[q, k, 0] = x / _NEAR_M * f + cx
                polygons[q, k, 1] = y / _NEAR_M * f + cy
                closest = _NEAR_M
                k += 1
        sides[q] = k
        nearest[q] = closest
    return polygons, sides, inverse_z, nearest


@nb.njit(parallel=True, cache=True, fastmath=True, nogil=True)
def _draw(
    order: NDArray[np.int64],
    polygons: Vector,
    sides: NDArray[np.int64],
    inverse_z: Vector,
    to_surface: Vector,
    paint: Vector,
    texels: Floats,
    table: NDArray[np.int64],
    light: Floats,
    sky: Floats,
    rotation: Vector,
    f: float,
    cx: float,
    cy: float,
    weight: float,
    first: bool,
    radiance: Floats,
    depth_m: Floats,
) -> None:
    """Draw in bands of fixed height, so that the result does not depend on the threads."""
    height, width = radiance.shape
    bands = (height + _BAND_ROWS - 1) // _BAND_ROWS
    for band in nb.prange(bands):
        top = band * _BAND_ROWS
        rows = min(_BAND_ROWS, height - top)
        best = np.zeros((rows, width), np.float32)
        owner = np.full((rows, width), -1, np.int32)
        for k in range(order.shape[0]):
            _cover(
                order[k],
                top,
                polygons,
                sides,
                inverse_z,
                to_surface,
                paint,
                texels,
                table,
                best,
                owner,
            )
        for row in range(rows):
            y = top + row
            for x in range(width):
                q = owner[row, x]
                channel = (x & 1) + (y & 1)
                if q < 0:
                    value = sky_radiance(sky, channel, rotation, (x - cx) / f, (y - cy) / f)
                else:
                    value = surface_radiance(
                        q, channel, x, y, to_surface, paint, texels, table, light
                    )
                radiance[y, x] += weight * value
                if first and q >= 0:
                    depth_m[y, x] = min(1.0 / best[row, x], FAR_M)


@nb.njit(cache=True, fastmath=True, nogil=True)
def _cover(
    q: int,
    top: int,
    polygons: Vector,
    sides: NDArray[np.int64],
    inverse_z: Vector,
    to_surface: Vector,
    paint: Vector,
    texels: Floats,
    table: NDArray[np.int64],
    best: Floats,
    owner: NDArray[np.int32],
) -> None:
    """Enter one quad into a band's depth buffer, row by row."""
    rows, width = best.shape
    n = sides[q]
    low = 1e9
    high = -1e9
    for i in range(n):
        low = min(low, polygons[q, i, 1])
        high = max(high, polygons[q, i, 1])
    cutout = int(paint[q, CUTOUT])
    for y in range(max(top, math.ceil(low)), min(top + rows - 1, math.floor(high)) + 1):
        left = 1e9
        right = -1e9
        for i in range(n):
            j = i + 1 if i + 1 < n else 0
            y0 = polygons[q, i, 1]
            y1 = polygons[q, j, 1]
            if (y0 <= y) != (y1 <= y):
                x = polygons[q, i, 0] + (y - y0) / (y1 - y0) * (
                    polygons[q, j, 0] - polygons[q, i, 0]
                )
                left = min(left, x)
                right = max(right, x)
        if left > right:
            continue
        start = max(0, math.ceil(max(left, -1.0)))
        stop = min(width - 1, math.ceil(min(right, width + 1.0)) - 1)
        row = y - top
        closeness = inverse_z[q, 0] * start + inverse_z[q, 1] * y + inverse_z[q, 2]
        for x in range(start, stop + 1):
            if closeness > best[row, x] and (
                cutout < 0 or opaque(q, cutout, x, y, to_surface, paint, texels, table)
            ):
                best[row, x] = closeness
                owner[row, x] = q
            closeness += inverse_z[q, 0]
