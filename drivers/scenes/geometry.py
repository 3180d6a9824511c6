"""A world as a list of flat, textured quads, and the same as arrays for the kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.drivers.scenes.textures import Atlas
from rig.drivers.scenes.trajectories import Path, Vector

Colour = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Material:
    """A grey albedo texture, the size of one tile, and what it is multiplied with.

    A `tile_m` of None stretches the texture once over each quad. `tint` are factors for the red,
    green and blue filter. `macro_per_m` > 0 lays a slow second texture over the first, so that
    tiles do not repeat; it is that texture's tiles per metre.
    """

    texture: str
    tile_m: tuple[float, float] | None
    tint: Colour = (1.0, 1.0, 1.0)
    macro_per_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Quad:
    """A convex, flat quad; `corners` 4 x 3 metres in order around it, `facing` its lit side.

    `texels_per_m` is the resolution of its baked light. `cutout` names a mask texture with
    the material's tile. A quad with `emitted_cd_m2` > 0 is a lamp. `solid` quads block light.
    """

    corners: Vector
    facing: Vector
    material: Material
    texels_per_m: float = 1.0
    offset: tuple[float, float] = (0.0, 0.0)
    cutout: str | None = None
    emitted_cd_m2: float = 0.0
    solid: bool = True


# Columns of `Surfaces.paint`; one plain array is far faster in kernels than many.
TEXTURE, CUTOUT, EMITTED, MACRO_PER_M = range(4)
U_SCALE, V_SCALE, U_OFFSET, V_OFFSET = range(4, 8)
LIGHT, LIGHT_WIDE, LIGHT_HIGH, PER_A, PER_B = range(8, 13)
TINT = 13


class Surfaces(NamedTuple):
    """The quads as arrays, row by row; what the kernels read. `paint` is what shading needs."""

    corners: NDArray[np.float64]
    origin: NDArray[np.float64]
    along_a: NDArray[np.float64]
    along_b: NDArray[np.float64]
    normal: NDArray[np.float64]
    length_m: NDArray[np.float64]
    emitted: NDArray[np.float64]
    solid: NDArray[np.bool_]
    albedo: NDArray[np.float64]
    light_table: NDArray[np.int64]
    paint: NDArray[np.float64]


_LARGEST_LIGHTMAP = 48


class Assembly:
    """Collects the quads of a world; every piece gets its own random place in its texture."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self.quads: list[Quad] = []

    def quad(
        self,
        corners: Sequence[Vector],
        facing: Vector,
        material: Material,
        texels_per_m: float = 1.0,
        *,
        cutout: str | None = None,
        emitted_cd_m2: float = 0.0,
        solid: bool = True,
        at_tile: tuple[float, float] | None = None,
    ) -> None:
        """Add one quad; the first edge is the texture's u, the last one its v.

        `at_tile` is where in its texture the quad begins, in tiles; at random when absent.
        """
        u, v = (float(value) for value in self._rng.random(2)) if at_tile is None else at_tile
        offset = (0.0, 0.0) if material.tile_m is None else (u, v)
        self.quads.append(
            Quad(
                np.array(corners, float),
                np.asarray(facing, float),
                material,
                texels_per_m,
                offset,
                cutout,
                emitted_cd_m2,
                solid,
            )
        )

    def floor(
        self,
        path: Path,
        along: tuple[float, float],
        across: tuple[float, float],
        up_m: float,
        material: Material,
        texels_per_m: float = 1.0,
        *,
        underside: bool = False,
        emitted_cd_m2: float = 0.0,
        solid: bool = True,
    ) -> None:
        """Add a level strip between two arc lengths and two offsets from the centreline."""
        s0, s1 = along
        d0, d1 = across
        corners = [
            path.at(s0, d0, up_m),
            path.at(s0, d1, up_m),
            path.at(s1, d1, up_m),
            path.at(s1, d0, up_m),
        ]
        facing = np.array([0.0, -1.0 if underside else 1.0, 0.0])
        self.quad(corners, facing, material, texels_per_m, emitted_cd_m2=emitted_cd_m2, solid=solid)

    def wall(
        self,
        path: Path,
        along: tuple[float, float],
        across_m: float,
        up: tuple[float, float],
        material: Material,
        texels_per_m: float = 1.0,
        *,
        solid: bool = True,
    ) -> None:
        """Add an upright strip along the road at one offset; its lit side faces the road."""
        s0, s1 = along if across_m < 0 else along[::-1]
        low, high = up
        around = ((s0, low), (s1, low), (s1, high), (s0, high))
        corners = [path.at(s, across_m, h) for s, h in around]
        facing = -np.sign(across_m) * path.right(0.5 * (s0 + s1))
        self.quad(corners, facing, material, texels_per_m, solid=solid)

    def gate(
        self,
        path: Path,
        s_m: float,
        across: tuple[float, float],
        up: tuple[float, float],
        material: Material,
        texels_per_m: float = 1.0,
        *,
        towards: float = -1.0,
        cutout: str | None = None,
        solid: bool = True,
    ) -> None:
        """Add an upright quad across the road; it faces back (-1) or ahead (+1)."""
        (d0, d1), (low, high) = across, up
        corners = [path.at(s_m, d, h) for d, h in ((d0, low), (d1, low), (d1, high), (d0, high))]
        facing = towards * path.ahead(s_m)
        self.quad(corners, facing, material, texels_per_m, cutout=cutout, solid=solid)

    def box(
        self,
        path: Path,
        along: tuple[float, float],
        across: tuple[float, float],
        up: tuple[float, float],
        material: Material,
        texels_per_m: float = 1.0,
        *,
        top: Material | None = None,
        ends: Material | None = None,
    ) -> None:
        """Add a box that follows the road's direction at its near end, without a bottom.

        `top` and `ends`, those that look along the road, are of `material` unless given.
        """
        s0, depth = along[0], along[1] - along[0]
        right, ahead, base = path.right(s0), path.ahead(s0), path.at(s0)
        rise = np.array([0.0, 1.0, 0.0])

        def corner(d: float, h: float, forward: float) -> Vector:
            return np.asarray(base + d * right + h * rise + forward * ahead)

        (d0, d1), (h0, h1) = across, up
        sides = (
            ((d0, 0.0), (d1, 0.0), -ahead, ends or material),
            ((d0, depth), (d1, depth), ahead, ends or material),
            ((d0, 0.0), (d0, depth), -right, material),
            ((d1, 0.0), (d1, depth), right, material),
        )
        for (da, fa), (db, fb), facing, stuff in sides:
            around = [
                corner(da, h0, fa),
                corner(db, h0, fb),
                corner(db, h1, fb),
                corner(da, h1, fa),
            ]
            self.quad(around, facing, stuff, texels_per_m)
        lid = [corner(d0, h1, 0), corner(d1, h1, 0), corner(d1, h1, depth), corner(d0, h1, depth)]
        self.quad(lid, rise, top or material, texels_per_m)


def surfaces(quads: Sequence[Quad], atlas: Atlas) -> Surfaces:
    """Return the quads as arrays; raises KeyError for a texture that the atlas lacks."""
    corners = np.stack([quad.corners for quad in quads])
    along_a, along_b = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]
    length = np.stack([np.linalg.norm(along_a, axis=1), np.linalg.norm(along_b, axis=1)], 1)
    normal = np.cross(along_a, along_b)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    facing = np.stack([quad.facing for quad in quads])
    normal *= np.where((normal * facing).sum(1) < 0, -1.0, 1.0)[:, None]
    tiles = [quad.material.tile_m or tuple(size) for quad, size in zip(quads, length, strict=True)]
    texture = np.array([atlas.index(quad.material.texture) for quad in quads])
    tint = np.array([quad.material.tint for quad in quads])
    density = np.array([quad.texels_per_m for quad in quads])[:, None]
    texels = np.clip(np.ceil(length * density), 2, _LARGEST_LIGHTMAP).astype(np.int64)
    ends = np.cumsum(texels.prod(1))
    light_table = np.concatenate([(ends - texels.prod(1))[:, None], texels], 1)
    emitted = np.array([quad.emitted_cd_m2 for quad in quads])
    masks = [-1 if quad.cutout is None else atlas.index(quad.cutout) for quad in quads]
    macro = [quad.material.macro_per_m for quad in quads]
    singles = np.stack([texture, np.array(masks), emitted, np.array(macro)], 1)
    offsets = np.array([quad.offset for quad in quads])
    return Surfaces(
        corners=corners,
        origin=np.ascontiguousarray(corners[:, 0]),
        along_a=along_a,
        along_b=along_b,
        normal=normal,
        length_m=length,
        emitted=emitted,
        solid=np.array([quad.solid for quad in quads]),
        albedo=atlas.mean[texture] * (tint @ [0.25, 0.5, 0.25]),
        light_table=light_table,
        paint=np.concatenate(
            [singles, 1 / np.array(tiles), offsets, light_table, 1 / length, tint], 1
        ),
    )
