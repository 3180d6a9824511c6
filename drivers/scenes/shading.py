"""What a surface or the sky sends to a pixel: textures, baked light, tint, cut-outs."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rig.drivers.scenes.geometry import Surfaces
from rig.drivers.scenes.trajectories import Vector

Floats = NDArray[np.float32]

# Columns of the table of what shading needs of each quad; plain arrays are far faster in kernels.
_TEXTURE, CUTOUT, _EMITTED, _MACRO = range(4)
_U_SCALE, _V_SCALE, _U_OFFSET, _V_OFFSET = range(4, 8)
_LIGHT, _LIGHT_WIDE, _LIGHT_HIGH, _PER_A, _PER_B = range(8, 13)
_TINT = 13

_MOST_TAPS = 8.0


def paint_table(surfaces: Surfaces) -> Vector:
    """Return what shading needs of each quad, one row a quad, in the columns named above."""
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


@nb.njit(cache=True, fastmath=True, nogil=True)
def opaque(
    q: int,
    cutout: int,
    x: int,
    y: int,
    to_surface: Vector,
    paint: Vector,
    texels: Floats,
    table: NDArray[np.int64],
) -> bool:
    """Return whether a cut-out quad (leaves, a fence) has material at pixel (x, y)."""
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
def sky_radiance(sky: Floats, channel: int, rotation: Vector, a: float, b: float) -> float:
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
def surface_radiance(
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
