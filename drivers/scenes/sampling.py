"""Texture and panorama look-ups for the kernels, without calls of transcendental functions."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

_FIXED_BITS = 16
_FIXED = float(1 << _FIXED_BITS)
_FRACTION = (1 << _FIXED_BITS) - 1
_TO_SHARE = np.float32(1.0 / _FIXED)
_QUARTER = 1 << (_FIXED_BITS - 2)

IN_ORDER = {"nnan", "ninf", "nsz", "arcp", "contract"}
"""Fast arithmetic that sums in the order written: vectors of a few taps would cost more."""

_MANTISSA = (1 << 52) - 1
_ONE = 1023 << 52


@nb.njit(cache=True, fastmath=True, nogil=True, inline="always")
def half_log2(x: float) -> float:
    """Return log2(sqrt(x)) of a normal x > 0 to 2e-5: its exponent, and a fit over [1, 2)."""
    bits = np.float64(x).view(np.int64)
    exponent = (bits >> 52) - 1023
    m = np.int64((bits & _MANTISSA) | _ONE).view(np.float64)
    tail = 1.5939013634991075 + m * (-0.40486717441919184 + m * 0.04342890782214256)
    log = -2.7868129538674205 + m * (5.046876044975866 + m * (-3.4924942798792724 + m * tail))
    return 0.5 * (exponent + log)


@nb.njit(cache=True, fastmath=True, nogil=True, inline="always")
def turns(y: float, x: float) -> float:
    """Return the angle of (x, y) from the x axis in turns, -0.5 to 0.5, to 5e-8."""
    across = abs(x)
    up = abs(y)
    low = min(across, up)
    high = max(across, up, 1e-30)
    t = low / high
    q = t * t
    tail = 0.10002088125754998 + q * (
        -0.06087256684585965 + q * (0.025330154769537153 - q * 0.0050205760065691035)
    )
    tail = -0.3333223229533885 + q * (0.19974023063581603 + q * (-0.14047784529237667 + q * tail))
    angle = t * (0.9999999227364114 + q * tail) * (0.5 / math.pi)
    if up > across:
        angle = 0.25 - angle
    if x < 0.0:
        angle = 0.5 - angle
    return angle if y >= 0.0 else -angle


@nb.njit(cache=True, fastmath=IN_ORDER, nogil=True, inline="always")
def filtered(
    texels: Floats,
    first: int,
    wide_bits: int,
    high_bits: int,
    levels: int,
    u: float,
    v: float,
    ux: float,
    vx: float,
    uy: float,
    vy: float,
    most_taps: float,
) -> float:
    """Sample a texture anisotropically: taps along the longer footprint axis, trilinear.

    `u` and `v` are in textures; `ux` .. `vy` is their change from a pixel to the next to the right
    and below. Places are counted in fixed point, so that steps and wrapping cost integer adds.
    """
    wide = float(1 << wide_bits)
    high = float(1 << high_bits)
    across = (ux * wide) ** 2 + (vx * high) ** 2
    down = (uy * wide) ** 2 + (vy * high) ** 2
    longer2 = max(across, down)
    du = ux if across > down else uy
    dv = vx if across > down else vy
    shorter2 = max(min(across, down), longer2 / (most_taps * most_taps), 1e-12)
    taps = int(min(max(math.ceil(math.sqrt(longer2 / shorter2) - 0.25), 1.0), most_taps))
    lod = half_log2(max(shorter2, 1.0))
    level = min(int(lod), levels - 1)
    between = np.float32(lod - level if level < levels - 1 else 0.0)
    texels_of_level_0 = 1 << (wide_bits + high_bits)
    offset = first + (texels_of_level_0 - (texels_of_level_0 >> (2 * level))) // 3 * 4
    shift = wide_bits - level
    mask_x = (1 << shift) - 1
    mask_y = (1 << (high_bits - level)) - 1
    scale_x = float(mask_x + 1) * _FIXED
    scale_y = float(mask_y + 1) * _FIXED
    share = 1.0 / taps
    back = 0.5 * share - 0.5
    step_x = int(du * share * scale_x)
    step_y = int(dv * share * scale_y)
    x = int((u + back * du) * scale_x) - 2 * _QUARTER
    y = int((v + back * dv) * scale_y) - 2 * _QUARTER
    total = np.float32(0)
    if between > np.float32(0.02):
        coarse = offset + (1 << (shift + high_bits - level))
        for _ in range(taps):
            fine = _bilinear(texels, offset, shift, mask_x, mask_y, x, y)
            rough = _bilinear(
                texels,
                coarse,
                shift - 1,
                mask_x >> 1,
                mask_y >> 1,
                (x >> 1) - _QUARTER,
                (y >> 1) - _QUARTER,
            )
            total += fine + (rough - fine) * between
            x += step_x
            y += step_y
    else:
        for _ in range(taps):
            total += _bilinear(texels, offset, shift, mask_x, mask_y, x, y)
            x += step_x
            y += step_y
    return float(total * np.float32(share))


@nb.njit(cache=True, fastmath=True, nogil=True, inline="always")
def _bilinear(
    texels: Floats, offset: int, shift: int, mask_x: int, mask_y: int, x: int, y: int
) -> np.float32:
    """Blend the four texels around a place in fixed point; `shift` is the log2 of the width."""
    x0 = (x >> _FIXED_BITS) & mask_x
    x1 = (x0 + 1) & mask_x
    y0 = (y >> _FIXED_BITS) & mask_y
    upper = offset + (y0 << shift)
    lower = offset + (((y0 + 1) & mask_y) << shift)
    p = np.float32(x & _FRACTION) * _TO_SHARE
    r = np.float32(y & _FRACTION) * _TO_SHARE
    a = texels[np.uint64(upper + x0)]
    c = texels[np.uint64(lower + x0)]
    top = a + (texels[np.uint64(upper + x1)] - a) * p
    low = c + (texels[np.uint64(lower + x1)] - c) * p
    return np.float32(top + (low - top) * r)
