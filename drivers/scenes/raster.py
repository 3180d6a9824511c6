"""A rasteriser for lit, textured quads: linear radiance and depth of one pinhole view."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics
from rig.drivers.scenes.geometry import Surfaces
from rig.drivers.scenes.textures import Atlas
from rig.drivers.scenes.trajectories import Pose, Vector

Floats = NDArray[np.float32]

# Columns of the table of what shading needs of each quad; plain arrays are far faster in kernels.
_TEXTURE, _CUTOUT, _EMITTED, _MACRO = range(4)
_U_SCALE, _V_SCALE, _U_OFFSET, _V_OFFSET = range(4, 8)
_LIGHT, _LIGHT_WIDE, _LIGHT_HIGH, _PER_A, _PER_B = range(8, 13)
_TINT = 13

FAR_M = 2000.0
"""The depth of the sky."""

_NEAR_M = 0.12
_BAND_ROWS = 48
_MOST_TAPS = 8.0
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
    paint = _paint(surfaces)
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


def _paint(surfaces: Surfaces) -> Vector:
    return np.column_stack(
        [
            surfaces.texture,
            surfaces.cutout,
            surfaces.emitted,
            surfaces.macro,
            surfaces.uv_scale,
            surfaces.uv_offset,
            surfaces.light_table,
            1.0 / surfaces.length_m,
            surfaces.tint,
        ]
    ).astype(np.float64)


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
                    value = _sky_radiance(sky, channel, rotation, (x - cx) / f, (y - cy) / f)
                else:
                    value = _surface_radiance(
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
    cutout = int(paint[q, _CUTOUT])
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
                cutout < 0 or _opaque(q, cutout, x, y, to_surface, paint, texels, table)
            ):
                best[row, x] = closeness
                owner[row, x] = q
            closeness += inverse_z[q, 0]


@nb.njit(cache=True, fastmath=True, nogil=True)
def _opaque(
    q: int,
    cutout: int,
    x: int,
    y: int,
    to_surface: Vector,
    paint: Vector,
    texels: Floats,
    table: NDArray[np.int64],
) -> bool:
    w = to_surface[q, 2, 0] * x + to_surface[q, 2, 1] * y + to_surface[q, 2, 2]
    u = (
        (to_surface[q, 0, 0] * x + to_surface[q, 0, 1] * y + to_surface[q, 0, 2])
        / w
        * paint[q, _U_SCALE]
    )
    v = (
        (to_surface[q, 1, 0] * x + to_surface[q, 1, 1] * y + to_surface[q, 1, 2])
        / w
        * paint[q, _V_SCALE]
    )
    wide = 1 << table[cutout, 1]
    high = 1 << table[cutout, 2]
    ix = int(u * wide) & (wide - 1)
    iy = int(v * high) & (high - 1)
    return bool(texels[table[cutout, 0] + iy * wide + ix] > 0.5)


@nb.njit(cache=True, fastmath=True, nogil=True)
def _sky_radiance(sky: Floats, channel: int, rotation: Vector, a: float, b: float) -> float:
    """Look up the panorama along the ray (a, b, 1) of the optical frame."""
    dx = rotation[0, 0] * a + rotation[1, 0] * b + rotation[2, 0]
    dy = rotation[0, 1] * a + rotation[1, 1] * b + rotation[2, 1]
    dz = rotation[0, 2] * a + rotation[1, 2] * b + rotation[2, 2]
    high = sky.shape[1]
    wide = sky.shape[2]
    u = (math.atan2(dx, dz) * (0.5 / math.pi) + 0.5) * wide - 0.5
    v = (0.5 - math.atan2(dy, math.sqrt(dx * dx + dz * dz)) / math.pi) * high - 0.5
    v = min(max(v, 0.0), high - 1.001)
    fu = math.floor(u)
    iu = int(fu)
    iv = int(v)
    p = u - fu
    r = v - iv
    i0 = iu % wide
    i1 = (iu + 1) % wide
    upper = sky[channel, iv, i0] * (1 - p) + sky[channel, iv, i1] * p
    lower = sky[channel, iv + 1, i0] * (1 - p) + sky[channel, iv + 1, i1] * p
    return float(upper * (1 - r) + lower * r)


@nb.njit(cache=True, fastmath=True, nogil=True)
def _surface_radiance(
    q: int,
    channel: int,
    x: int,
    y: int,
    to_surface: Vector,
    paint: Vector,
    texels: Floats,
    table: NDArray[np.int64],
    light: Floats,
) -> float:
    """Lambert: albedo times baked illuminance over pi; a lamp shines by itself."""
    if paint[q, _EMITTED] > 0:
        return float(paint[q, _EMITTED] * paint[q, _TINT + channel])
    w = 1.0 / (to_surface[q, 2, 0] * x + to_surface[q, 2, 1] * y + to_surface[q, 2, 2])
    s = (to_surface[q, 0, 0] * x + to_surface[q, 0, 1] * y + to_surface[q, 0, 2]) * w
    t = (to_surface[q, 1, 0] * x + to_surface[q, 1, 1] * y + to_surface[q, 1, 2]) * w
    sx = (to_surface[q, 0, 0] - s * to_surface[q, 2, 0]) * w
    sy = (to_surface[q, 0, 1] - s * to_surface[q, 2, 1]) * w
    tx = (to_surface[q, 1, 0] - t * to_surface[q, 2, 0]) * w
    ty = (to_surface[q, 1, 1] - t * to_surface[q, 2, 1]) * w
    ku = paint[q, _U_SCALE]
    kv = paint[q, _V_SCALE]
    ou = paint[q, _U_OFFSET]
    ov = paint[q, _V_OFFSET]
    albedo = _filtered(
        texels,
        table,
        int(paint[q, _TEXTURE]),
        s * ku + ou,
        t * kv + ov,
        sx * ku,
        tx * kv,
        sy * ku,
        ty * kv,
        _MOST_TAPS,
    )
    km = paint[q, _MACRO]
    if km > 0:
        slow = _filtered(
            texels,
            table,
            0,
            s * km + 0.61 * ov,
            t * km + 0.37 * ou,
            sx * km,
            tx * km,
            sy * km,
            ty * km,
            2.0,
        )
        albedo *= 0.8 + 0.4 * slow
    wide = int(paint[q, _LIGHT_WIDE])
    high = int(paint[q, _LIGHT_HIGH])
    u = min(max(s * paint[q, _PER_A] * wide - 0.5, 0.0), wide - 1.001)
    v = min(max(t * paint[q, _PER_B] * high - 0.5, 0.0), high - 1.001)
    iu = int(u)
    iv = int(v)
    p = u - iu
    r = v - iv
    offset = int(paint[q, _LIGHT]) + iv * wide + iu
    upper = light[offset] * (1 - p) + light[offset + 1] * p
    lower = light[offset + wide] * (1 - p) + light[offset + wide + 1] * p
    lux = upper * (1 - r) + lower * r
    return float(albedo * paint[q, _TINT + channel] * lux * (1.0 / math.pi))


@nb.njit(cache=True, fastmath=True, nogil=True)
def _filtered(
    texels: Floats,
    table: NDArray[np.int64],
    k: int,
    u: float,
    v: float,
    ux: float,
    vx: float,
    uy: float,
    vy: float,
    most_taps: float,
) -> float:
    """Sample a texture anisotropically: taps along the longer footprint axis, trilinear."""
    wide = 1 << table[k, 1]
    high = 1 << table[k, 2]
    levels = table[k, 3]
    across = math.sqrt((ux * wide) ** 2 + (vx * high) ** 2)
    down = math.sqrt((uy * wide) ** 2 + (vy * high) ** 2)
    if across > down:
        longer, shorter, du, dv = across, down, ux, vx
    else:
        longer, shorter, du, dv = down, across, uy, vy
    shorter = max(shorter, longer / most_taps, 1e-6)
    taps = int(min(max(math.ceil(longer / shorter - 0.25), 1.0), most_taps))
    lod = max(0.0, math.log2(shorter))
    level = int(lod)
    between = lod - level
    if level >= levels - 1:
        level = levels - 1
        between = 0.0
    offset = table[k, 0]
    for _ in range(level):
        offset += wide * high
        wide >>= 1
        high >>= 1
    total = 0.0
    for i in range(taps):
        a = (i + 0.5) / taps - 0.5
        value = _bilinear(texels, offset, wide, high, u + a * du, v + a * dv)
        if between > 0.02:
            coarse = _bilinear(
                texels, offset + wide * high, wide >> 1, high >> 1, u + a * du, v + a * dv
            )
            value = value * (1 - between) + coarse * between
        total += value
    return total / taps


@nb.njit(cache=True, fastmath=True, nogil=True, inline="always")
def _bilinear(texels: Floats, offset: int, wide: int, high: int, u: float, v: float) -> float:
    x = u * wide - 0.5
    y = v * high - 0.5
    fx = math.floor(x)
    fy = math.floor(y)
    p = x - fx
    r = y - fy
    x0 = int(fx) & (wide - 1)
    y0 = int(fy) & (high - 1)
    x1 = (x0 + 1) & (wide - 1)
    y1 = (y0 + 1) & (high - 1)
    upper = texels[offset + y0 * wide + x0] * (1 - p) + texels[offset + y0 * wide + x1] * p
    lower = texels[offset + y1 * wide + x0] * (1 - p) + texels[offset + y1 * wide + x1] * p
    return float(upper * (1 - r) + lower * r)
