"""Baked light: the illuminance of every surface from sun, sky, lamps and bounces.

Sun and lamps are sampled directly with shadow rays; the sky and the light that other surfaces
return are gathered over the hemisphere by quasi-Monte Carlo, twice, so that light arrives after
up to two diffuse bounces.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numba as nb
import numpy as np
from numpy.typing import NDArray

from rig.drivers.scenes.geometry import Surfaces
from rig.drivers.scenes.trajectories import Vector

LIGHT_VERSION = "light/2"
"""Part of the cache key: a change here bakes every world again."""

STREET_RAYS = (16, 48)
ROOM_RAYS = (32, 32, 48, 320)
"""Walls return more light than streets do, and daylight comes through small openings."""

_SUN_RAYS = 4
_LAMP_REACH_M = 60.0
_LIFT_M = 0.02
_LEAF = 2


class Sunlight(NamedTuple):
    """`towards` is the unit vector to the sun; the rest is daylight's strength."""

    towards: Vector
    normal_lux: float
    sky_cd_m2: float
    ground_cd_m2: float


class Tree(NamedTuple):
    """Bounding boxes in depth-first order; `skip` is the next box when one is missed.

    `inverse_a` and `inverse_b` turn a place on a quad into shares of its two edges; in these
    coordinates its corners are (0, 0), (1, 0), `far_corner` and (0, 1).
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    skip: NDArray[np.int64]
    first: NDArray[np.int64]
    held: NDArray[np.int64]
    quads: NDArray[np.int64]
    inverse_a: NDArray[np.float64]
    inverse_b: NDArray[np.float64]
    far_corner: NDArray[np.float64]


def bake(
    surfaces: Surfaces, sun: Sunlight, rays: tuple[int, ...] = STREET_RAYS
) -> NDArray[np.float32]:
    """Return the illuminance, lux, of all texels of `surfaces.light_table`, flat.

    `rays` are those that gather light in each texel, one number for each bounce.
    """
    tree = _build_tree(surfaces)
    direct = np.zeros(int(surfaces.light_table[-1, 0] + surfaces.light_table[-1, 1:].prod()))
    lamps = np.flatnonzero(surfaces.emitted > 0)
    _bake_direct(surfaces, tree, sun, lamps, direct)
    total = direct
    for count in rays:
        gathered = np.zeros_like(direct)
        _gather(surfaces, tree, sun, count, total, gathered)
        total = direct + _smooth(surfaces, gathered)
    return total.astype(np.float32)


def _smooth(surfaces: Surfaces, light: Vector) -> Vector:
    """Blur the gathered light of each surface a little: it varies slowly, its noise does not."""
    out = light.copy()
    for offset, wide, high in surfaces.light_table:
        part = slice(offset, offset + wide * high)
        image = light[part].reshape(high, wide)
        smooth = cv2.GaussianBlur(image, (0, 0), 1.0, borderType=cv2.BORDER_REPLICATE)
        out[part] = smooth.ravel()
    return out


def _build_tree(surfaces: Surfaces) -> Tree:
    blockers = np.flatnonzero(surfaces.solid)
    low, high = surfaces.corners.min(1), surfaces.corners.max(1)
    middle = 0.5 * (low + high)
    nodes: list[tuple[Vector, Vector, int, int]] = []
    skip: list[int] = []
    ordered: list[int] = []

    def grow(members: NDArray[np.int64]) -> None:
        here = len(nodes)
        box = (low[members].min(0) - 1e-4, high[members].max(0) + 1e-4)
        leaf = len(members) <= _LEAF
        nodes.append((*box, len(ordered), len(members) if leaf else 0))
        skip.append(0)
        if leaf:
            ordered.extend(int(q) for q in members)
        else:
            axis = int(np.argmax(np.ptp(middle[members], axis=0)))
            ranked = members[np.argsort(middle[members, axis], kind="stable")]
            grow(ranked[: len(ranked) // 2])
            grow(ranked[len(ranked) // 2 :])
        skip[here] = len(nodes)

    grow(blockers)
    a, b = surfaces.along_a, surfaces.along_b
    aa, bb, ab = (a * a).sum(1), (b * b).sum(1), (a * b).sum(1)
    area2 = (aa * bb - ab * ab)[:, None]
    inverse_a = (a * bb[:, None] - b * ab[:, None]) / area2
    inverse_b = (b * aa[:, None] - a * ab[:, None]) / area2
    diagonal = surfaces.corners[:, 2] - surfaces.corners[:, 0]
    return Tree(
        low=np.array([node[0] for node in nodes]),
        high=np.array([node[1] for node in nodes]),
        skip=np.array(skip),
        first=np.array([node[2] for node in nodes]),
        held=np.array([node[3] for node in nodes]),
        quads=np.array(ordered),
        inverse_a=inverse_a,
        inverse_b=inverse_b,
        far_corner=np.stack([(diagonal * inverse_a).sum(1), (diagonal * inverse_b).sum(1)], 1),
    )


@nb.njit(cache=True, fastmath=True, nogil=True)
def _nearest(
    surfaces: Surfaces,
    tree: Tree,
    p: tuple[float, float, float],
    d: tuple[float, float, float],
    reach: float,
    any_hit: bool,
) -> tuple[int, float]:
    """Return the nearest blocker along a ray and its distance; -1 without one."""
    i0 = 1.0 / d[0] if abs(d[0]) > 1e-12 else 1e12
    i1 = 1.0 / d[1] if abs(d[1]) > 1e-12 else 1e12
    i2 = 1.0 / d[2] if abs(d[2]) > 1e-12 else 1e12
    best = reach
    hit = -1
    node = 0
    nodes = tree.skip.shape[0]
    while node < nodes:
        x0 = (tree.low[node, 0] - p[0]) * i0
        x1 = (tree.high[node, 0] - p[0]) * i0
        y0 = (tree.low[node, 1] - p[1]) * i1
        y1 = (tree.high[node, 1] - p[1]) * i1
        z0 = (tree.low[node, 2] - p[2]) * i2
        z1 = (tree.high[node, 2] - p[2]) * i2
        enter = max(min(x0, x1), min(y0, y1), min(z0, z1))
        leave = min(max(x0, x1), max(y0, y1), max(z0, z1))
        if leave < max(enter, 0.0) or enter > best:
            node = tree.skip[node]
            continue
        for k in range(tree.first[node], tree.first[node] + tree.held[node]):
            q = tree.quads[k]
            t = _meet(surfaces, tree, q, p, d)
            if 1e-3 < t < best:
                best = t
                hit = q
                if any_hit:
                    return hit, best
        node += 1
    return hit, best


@nb.njit(cache=True, fastmath=True, nogil=True, inline="always")
def _meet(
    surfaces: Surfaces,
    tree: Tree,
    q: int,
    p: tuple[float, float, float],
    d: tuple[float, float, float],
) -> float:
    """Return the distance at which a ray meets a quad, -1 where it does not."""
    n = surfaces.normal[q]
    o = surfaces.origin[q]
    along = n[0] * d[0] + n[1] * d[1] + n[2] * d[2]
    if abs(along) < 1e-9:
        return -1.0
    t = (n[0] * (o[0] - p[0]) + n[1] * (o[1] - p[1]) + n[2] * (o[2] - p[2])) / along
    x = p[0] + t * d[0] - o[0]
    y = p[1] + t * d[1] - o[1]
    z = p[2] + t * d[2] - o[2]
    ia = tree.inverse_a[q]
    ib = tree.inverse_b[q]
    a = x * ia[0] + y * ia[1] + z * ia[2]
    b = x * ib[0] + y * ib[1] + z * ib[2]
    fa = tree.far_corner[q, 0]
    fb = tree.far_corner[q, 1]
    right = (fa - 1.0) * b - fb * (a - 1.0)
    top = -fa * (b - fb) - (1.0 - fb) * (a - fa)
    if a < 0.0 or b < 0.0 or right < 0.0 or top < 0.0:
        return -1.0
    return float(t)


@nb.njit(cache=True, fastmath=True, nogil=True, inline="always")
def _texel(surfaces: Surfaces, q: int, fu: float, fv: float) -> tuple[float, float, float]:
    """Return the world point of a place on a quad, lifted off it."""
    o = surfaces.origin[q]
    a = surfaces.along_a[q]
    b = surfaces.along_b[q]
    n = surfaces.normal[q]
    return (
        o[0] + fu * a[0] + fv * b[0] + _LIFT_M * n[0],
        o[1] + fu * a[1] + fv * b[1] + _LIFT_M * n[1],
        o[2] + fu * a[2] + fv * b[2] + _LIFT_M * n[2],
    )


@nb.njit(parallel=True, cache=True, fastmath=True, nogil=True)
def _bake_direct(
    surfaces: Surfaces, tree: Tree, sun: Sunlight, lamps: NDArray[np.int64], out: Vector
) -> None:
    """Add what arrives straight from the sun (soft at texel size) and from the lamps."""
    towards = (sun.towards[0], sun.towards[1], sun.towards[2])
    for q in nb.prange(surfaces.emitted.shape[0]):
        n = surfaces.normal[q]
        offset = surfaces.light_table[q, 0]
        wide = surfaces.light_table[q, 1]
        high = surfaces.light_table[q, 2]
        slant = n[0] * towards[0] + n[1] * towards[1] + n[2] * towards[2]
        for iy in range(high):
            for ix in range(wide):
                lux = 0.0
                if slant > 0:
                    for k in range(_SUN_RAYS):
                        fu = (ix + 0.25 + 0.5 * (k & 1)) / wide
                        fv = (iy + 0.25 + 0.5 * (k >> 1)) / high
                        p = _texel(surfaces, q, fu, fv)
                        hit, _ = _nearest(surfaces, tree, p, towards, 300.0, True)
                        if hit < 0:
                            lux += slant * sun.normal_lux / _SUN_RAYS
                p = _texel(surfaces, q, (ix + 0.5) / wide, (iy + 0.5) / high)
                for k in range(lamps.shape[0]):
                    lux += _lamp_lux(surfaces, tree, lamps[k], q, p)
                out[offset + iy * wide + ix] = lux


@nb.njit(cache=True, fastmath=True, nogil=True)
def _lamp_lux(
    surfaces: Surfaces, tree: Tree, lamp: int, q: int, p: tuple[float, float, float]
) -> float:
    """Return the illuminance from one lamp, taken as a small flat source."""
    o = surfaces.origin[lamp]
    a = surfaces.along_a[lamp]
    b = surfaces.along_b[lamp]
    n = surfaces.normal[lamp]
    x = o[0] + 0.5 * (a[0] + b[0]) - p[0]
    y = o[1] + 0.5 * (a[1] + b[1]) - p[1]
    z = o[2] + 0.5 * (a[2] + b[2]) - p[2]
    distance = math.sqrt(x * x + y * y + z * z)
    if distance > _LAMP_REACH_M or distance < 1e-6:
        return 0.0
    d = (x / distance, y / distance, z / distance)
    m = surfaces.normal[q]
    arrive = m[0] * d[0] + m[1] * d[1] + m[2] * d[2]
    leave = -(n[0] * d[0] + n[1] * d[1] + n[2] * d[2])
    if arrive <= 0 or leave <= 0:
        return 0.0
    hit, _ = _nearest(surfaces, tree, p, d, distance - 0.05, True)
    if hit >= 0:
        return 0.0
    area = surfaces.length_m[lamp, 0] * surfaces.length_m[lamp, 1]
    lux = surfaces.emitted[lamp] * area * arrive * leave / max(distance * distance, area)
    return float(lux)


@nb.njit(parallel=True, cache=True, fastmath=True, nogil=True)
def _gather(
    surfaces: Surfaces, tree: Tree, sun: Sunlight, rays: int, before: Vector, out: Vector
) -> None:
    """Collect the sky and the light of other surfaces over each texel's hemisphere."""
    for q in nb.prange(surfaces.emitted.shape[0]):
        if surfaces.emitted[q] > 0:
            continue
        n = surfaces.normal[q]
        if abs(n[1]) < 0.9:
            scale = 1.0 / math.sqrt(n[0] * n[0] + n[2] * n[2])
            t = (n[2] * scale, 0.0, -n[0] * scale)
        else:
            scale = 1.0 / math.sqrt(n[1] * n[1] + n[2] * n[2])
            t = (0.0, -n[2] * scale, n[1] * scale)
        b = (n[1] * t[2] - n[2] * t[1], n[2] * t[0] - n[0] * t[2], n[0] * t[1] - n[1] * t[0])
        offset = surfaces.light_table[q, 0]
        wide = surfaces.light_table[q, 1]
        high = surfaces.light_table[q, 2]
        for iy in range(high):
            for ix in range(wide):
                p = _texel(surfaces, q, (ix + 0.5) / wide, (iy + 0.5) / high)
                texel = offset + iy * wide + ix
                total = 0.0
                for r in range(rays):
                    # A rotated Fibonacci lattice: even over the disc, different in each texel.
                    u1 = (r + (texel * 0.7548776662) % 1.0) / rays
                    turn = 2 * math.pi * ((r * 0.6180339887 + texel * 0.5698402910) % 1.0)
                    radius = math.sqrt(u1)
                    up = math.sqrt(1 - u1)
                    du = radius * math.cos(turn)
                    dv = radius * math.sin(turn)
                    d = (
                        du * t[0] + dv * b[0] + up * n[0],
                        du * t[1] + dv * b[1] + up * n[1],
                        du * t[2] + dv * b[2] + up * n[2],
                    )
                    total += _radiance_from(surfaces, tree, sun, p, d, before)
                out[texel] = math.pi * total / rays


@nb.njit(cache=True, fastmath=True, nogil=True)
def _radiance_from(
    surfaces: Surfaces,
    tree: Tree,
    sun: Sunlight,
    p: tuple[float, float, float],
    d: tuple[float, float, float],
    before: Vector,
) -> float:
    """Return the radiance that arrives along a ray; lamps count as direct light, not here."""
    hit, distance = _nearest(surfaces, tree, p, d, 400.0, False)
    if hit < 0:
        return sun.sky_cd_m2 if d[1] > 0 else sun.ground_cd_m2
    if surfaces.emitted[hit] > 0:
        return 0.0
    o = surfaces.origin[hit]
    x = p[0] + distance * d[0] - o[0]
    y = p[1] + distance * d[1] - o[1]
    z = p[2] + distance * d[2] - o[2]
    ia = tree.inverse_a[hit]
    ib = tree.inverse_b[hit]
    offset = surfaces.light_table[hit, 0]
    wide = surfaces.light_table[hit, 1]
    high = surfaces.light_table[hit, 2]
    iu = min(max(int((x * ia[0] + y * ia[1] + z * ia[2]) * wide), 0), wide - 1)
    iv = min(max(int((x * ib[0] + y * ib[1] + z * ib[2]) * high), 0), high - 1)
    return float(before[offset + iv * wide + iu] * surfaces.albedo[hit] / math.pi)
