"""Texture and panorama look-ups for the kernels, without calls of transcendental functions."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Vector = NDArray[np.float64]

_FIXED_BITS = 16
_FIXED = float(1 << _FIXED_BITS)
_FRACTION = (1 << _FIXED_BITS) - 1
_TO_SHARE = np.float32(1.0 / _FIXED)
_QUARTER = 1 << (_FIXED_BITS - 2)

_MANTISSA = (1 << 23) - 1
_ONE = 127 << 23

IN_ORDER = {"nnan", "ninf", "nsz", "arcp", "contract"}
"""Fast arithmetic that sums in the order written: vectors of a few taps would cost more."""

RUN_PX = 64
"""Pixels are shaded in runs of up to this many."""

# Columns of the scratch memory of a run, each RUN_PX long. One array at constant distances lets
# the compiler see that nothing overlaps, so that the loops over a run become vector code.
S, T, _W, _X, _Y, _STEP_X, _STEP_Y, _LOD, _TAPS, VALUE, SLOW = (
    np.uint64(RUN_PX * k) for k in range(11)
)
SCRATCH_SIZE = 11 * RUN_PX


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy", inline="always")
def _half_log2(x: np.float32) -> np.float32:
    """Return log2(sqrt(x)) of x >= 1 to 2e-5: its exponent, and a fit over [1, 2)."""
    bits = x.view(np.int32)
    exponent = np.float32((bits >> np.int32(23)) - np.int32(127))
    m = np.int32((bits & np.int32(_MANTISSA)) | np.int32(_ONE)).view(np.float32)
    tail = np.float32(1.5939014) + m * (np.float32(-0.40486717) + m * np.float32(0.043428908))
    tail = np.float32(5.046876) + m * (np.float32(-3.4924943) + m * tail)
    return np.float32(np.float32(0.5) * (exponent + (np.float32(-2.786813) + m * tail)))


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def place(h: Vector, x: float, y: float, count: int, run: Vector) -> None:
    """Find where on its quad each pixel of a run from (x, y) looks, and 1/depth's inverse."""
    s_at_0 = h[1] * y + h[2]
    t_at_0 = h[4] * y + h[5]
    w_at_0 = h[7] * y + h[8]
    h0, h3, h6 = h[0], h[3], h[6]
    for k in range(count):
        i = np.uint64(k)
        at = x + k
        w = 1.0 / (h6 * at + w_at_0)
        run[_W + i] = w
        run[S + i] = (h0 * at + s_at_0) * w
        run[T + i] = (h3 * at + t_at_0) * w


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy", inline="always")
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


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def footprint(
    h: Vector,
    tiles: tuple[float, float, float, float],
    texture: NDArray[np.int64],
    most_taps: float,
    count: int,
    run: Vector,
) -> None:
    """Find for each pixel of a run the taps along the longer axis of its footprint in a texture.

    `tiles` are the textures per metre along both edges and the offset of the first. Places and
    steps are in texels of the finest level.
    """
    wide = float(1 << texture[1])
    high = float(1 << texture[2])
    ku = tiles[0] * wide
    kv = tiles[1] * high
    ou = tiles[2] * wide
    ov = tiles[3] * high
    least = 1.0 / (most_taps * most_taps)
    h0, h1, h3, h4, h6, h7 = h[0], h[1], h[3], h[4], h[6], h[7]
    for k in range(count):
        i = np.uint64(k)
        s = run[S + i]
        t = run[T + i]
        w = run[_W + i]
        ux = (h0 - s * h6) * w * ku
        uy = (h1 - s * h7) * w * ku
        vx = (h3 - t * h6) * w * kv
        vy = (h4 - t * h7) * w * kv
        across = ux * ux + vx * vx
        down = uy * uy + vy * vy
        longer2 = max(across, down)
        shorter2 = max(min(across, down), longer2 * least, 1e-12)
        taps = min(max(math.ceil(math.sqrt(longer2 / shorter2) - 0.25), 1.0), most_taps)
        share = 1.0 / taps
        du = (ux if across > down else uy) * share
        dv = (vx if across > down else vy) * share
        back = 0.5 - 0.5 * taps
        run[_X + i] = s * ku + ou + back * du
        run[_Y + i] = t * kv + ov + back * dv
        run[_STEP_X + i] = du
        run[_STEP_Y + i] = dv
        run[_TAPS + i] = taps
        run[_LOD + i] = np.float64(_half_log2(np.float32(max(shorter2, 1.0))))


@nb.njit(cache=True, fastmath=IN_ORDER, nogil=True, error_model="numpy")
def sample(texels: Floats, texture: NDArray[np.int64], count: int, run: Vector) -> None:
    """Average the taps of each pixel of a run, trilinear, into VALUE.

    `texture` is its row of the atlas' table. Places are counted in fixed point, so that steps and
    wrapping cost integer adds.
    """
    first, wide_bits, high_bits, levels = texture
    texels_of_level_0 = 1 << (wide_bits + high_bits)
    for k in range(count):
        i = np.uint64(k)
        lod = run[_LOD + i]
        taps = int(run[_TAPS + i])
        level = min(int(lod), levels - 1)
        between = np.float32(lod - level if level < levels - 1 else 0.0)
        offset = first + (texels_of_level_0 - (texels_of_level_0 >> (2 * level))) // 3 * 4
        shift = wide_bits - level
        mask_x = (1 << shift) - 1
        mask_y = (1 << (high_bits - level)) - 1
        scale = float(1 << (_FIXED_BITS + 8 - level)) * (1.0 / 256.0)
        step_x = int(run[_STEP_X + i] * scale)
        step_y = int(run[_STEP_Y + i] * scale)
        x = int(run[_X + i] * scale) - 2 * _QUARTER
        y = int(run[_Y + i] * scale) - 2 * _QUARTER
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
        run[VALUE + i] = total / np.float32(taps)


@nb.njit(cache=True, fastmath=True, nogil=True, error_model="numpy", inline="always")
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
