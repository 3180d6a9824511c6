"""What a surface or the sky sends to a row of pixels: textures, baked light, tint, cut-outs."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rig.drivers.scenes.geometry import (
    CUTOUT,
    EMITTED,
    LIGHT,
    LIGHT_HIGH,
    LIGHT_WIDE,
    MACRO_PER_M,
    PER_A,
    PER_B,
    TEXTURE,
    TINT,
    U_OFFSET,
    U_SCALE,
    V_OFFSET,
    V_SCALE,
)
from rig.drivers.scenes.sampling import IN_ORDER, SLOW, VALUE, S, T, footprint, place, sample, turns
from rig.drivers.scenes.trajectories import Vector

Floats = NDArray[np.float32]

_MOST_TAPS = 8.0
_MACRO_TAPS = 2.0


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def opaque(
    x: float, y: float, to_surface: Vector, paint: Vector, texels: Floats, table: NDArray[np.int64]
) -> bool:
    """Return whether a cut-out quad (leaves, a fence) has material at the place (x, y)."""
    w = 1.0 / (to_surface[6] * x + to_surface[7] * y + to_surface[8])
    s = (to_surface[0] * x + to_surface[1] * y + to_surface[2]) * w
    t = (to_surface[3] * x + to_surface[4] * y + to_surface[5]) * w
    cutout = int(paint[CUTOUT])
    wide = 1 << table[cutout, 1]
    high = 1 << table[cutout, 2]
    ix = int(s * paint[U_SCALE] * wide) & (wide - 1)
    iy = int(t * paint[V_SCALE] * high) & (high - 1)
    return bool(texels[table[cutout, 0] + iy * wide + ix] > 0.5)


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def add_sky(
    sky: Floats,
    rotation: Vector,
    first: tuple[float, float, float],
    channels: tuple[int, int],
    weight: float,
    row: Floats,
    grey: Floats,
) -> None:
    """Add to a run of pixels, in colour and in grey, what the panorama shows along their rays.

    The ray of pixel i is (a + i * step, b, 1) in the optical frame, `first` holds a, b and step;
    `channels` are those of the first and the second pixel, then of every other one.
    """
    high = sky.shape[1]
    wide = sky.shape[2]
    for i in range(row.size):
        a = first[0] + i * first[2]
        dx = rotation[0, 0] * a + rotation[1, 0] * first[1] + rotation[2, 0]
        dy = rotation[0, 1] * a + rotation[1, 1] * first[1] + rotation[2, 1]
        dz = rotation[0, 2] * a + rotation[1, 2] * first[1] + rotation[2, 2]
        u = (turns(dx, dz) + 0.5) * wide - 0.5
        v = (0.5 - 2.0 * turns(dy, math.sqrt(dx * dx + dz * dz))) * high - 0.5
        v = min(max(v, 0.0), high - 1.001)
        iu = int(u + 1.0) - 1
        iv = int(v)
        p = u - iu
        r = v - iv
        i0 = iu if iu >= 0 else wide - 1
        i1 = iu + 1 if iu + 1 < wide else 0
        weights = (
            np.float32(weight * (1 - p) * (1 - r)),
            np.float32(weight * p * (1 - r)),
            np.float32(weight * (1 - p) * r),
            np.float32(weight * p * r),
        )
        colour = (
            _blend(sky[0], iv, i0, i1, weights),
            _blend(sky[1], iv, i0, i1, weights),
            _blend(sky[2], iv, i0, i1, weights),
        )
        row[i] += colour[channels[i & 1]]
        grey[i] += np.float32(0.25) * (colour[0] + colour[2]) + np.float32(0.5) * colour[1]


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy", inline="always")
def _blend(
    plane: Floats,
    iv: int,
    i0: int,
    i1: int,
    weights: tuple[np.float32, np.float32, np.float32, np.float32],
) -> np.float32:
    return np.float32(
        plane[iv, i0] * weights[0]
        + plane[iv, i1] * weights[1]
        + plane[iv + 1, i0] * weights[2]
        + plane[iv + 1, i1] * weights[3]
    )


@nb.njit(cache=True, fastmath=IN_ORDER, nogil=True, error_model="numpy")
def add_surface(
    to_surface: Vector,
    paint: Vector,
    x: float,
    y: float,
    channels: tuple[int, int],
    weight: float,
    texels: Floats,
    table: NDArray[np.int64],
    light: Floats,
    scratch: Vector,
    row: Floats,
    grey: Floats,
) -> None:
    """Add to up to RUN_PX pixels from (x, y) on, in colour and in grey, what one quad sends there.

    Lambert: albedo times baked illuminance over pi; a lamp shines by itself.
    """
    count = row.size
    tint = (paint[TINT + channels[0]], paint[TINT + channels[1]])
    grey_tint = 0.25 * (paint[TINT] + paint[TINT + 2]) + 0.5 * paint[TINT + 1]
    if paint[EMITTED] > 0:
        for k in range(count):
            row[k] += np.float32(weight * paint[EMITTED] * tint[k & 1])
            grey[k] += np.float32(weight * paint[EMITTED] * grey_tint)
        return
    place(to_surface, x, y, count, scratch)
    slow_per_m = paint[MACRO_PER_M]
    if slow_per_m > 0:
        tiles = (slow_per_m, slow_per_m, 0.61 * paint[V_OFFSET], 0.37 * paint[U_OFFSET])
        footprint(to_surface, tiles, table[0], _MACRO_TAPS, count, scratch)
        sample(texels, table[0], count, scratch)
        for k in range(count):
            i = np.uint64(k)
            scratch[SLOW + i] = 0.8 + 0.4 * scratch[VALUE + i]
    else:
        for k in range(count):
            scratch[SLOW + np.uint64(k)] = 1.0
    texture = table[int(paint[TEXTURE])]
    tiles = (paint[U_SCALE], paint[V_SCALE], paint[U_OFFSET], paint[V_OFFSET])
    footprint(to_surface, tiles, texture, _MOST_TAPS, count, scratch)
    sample(texels, texture, count, scratch)
    light_first = int(paint[LIGHT])
    light_wide = int(paint[LIGHT_WIDE])
    per_a = paint[PER_A] * light_wide
    per_b = paint[PER_B] * paint[LIGHT_HIGH]
    last_a = light_wide - 1.001
    last_b = paint[LIGHT_HIGH] - 1.001
    scale = weight / math.pi
    for k in range(count):
        i = np.uint64(k)
        u = min(max(scratch[S + i] * per_a - 0.5, 0.0), last_a)
        v = min(max(scratch[T + i] * per_b - 0.5, 0.0), last_b)
        iu = int(u)
        iv = int(v)
        p = u - iu
        r = v - iv
        near = np.uint64(light_first + iv * light_wide + iu)
        far = np.uint64(light_first + iv * light_wide + iu + light_wide)
        one = np.uint64(1)
        upper = light[near] * (1 - p) + light[near + one] * p
        lower = light[far] * (1 - p) + light[far + one] * p
        lux = upper * (1 - r) + lower * r
        white = scratch[VALUE + i] * scratch[SLOW + i] * lux * scale
        row[k] += np.float32(white * tint[k & 1])
        grey[k] += np.float32(white * grey_tint)
