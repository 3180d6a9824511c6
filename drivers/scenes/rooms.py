"""Pieces of buildings: rooms with openings, doors, windows, lamps, furniture.

A building stands in one frame: x right, y up, z ahead, metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rig.drivers.scenes.geometry import Assembly, Colour, Material, Quad
from rig.drivers.scenes.interiors import POSTERS, SHELVES
from rig.drivers.scenes.trajectories import Path, Vector

_PANEL_M = 2.4
_WALL_M = 0.3
_TEXELS_PER_M = 5.0
"""Of the light on walls, floors and ceilings: edges of sunlight are 20 cm soft."""

STRAIGHT = Path((), 1.0)
"""The frame of a building as a path: along is z, across is x."""

METAL = Material("metal", (1.0, 1.0), (1.5, 1.5, 1.5))
WOOD = Material("wood", (1.2, 1.2), (1.1, 0.9, 0.65))
DARK = Material("plastic", (0.6, 0.6))
WHITE = Material("steel", (1.0, 1.0), (1.6, 1.6, 1.55))
LAMP = Material("blank", (1.0, 1.0), (1.0, 1.0, 0.95))
FOLIAGE = Material("foliage", None, (0.75, 1.25, 0.4))


class Opening(NamedTuple):
    """A hole in a wall: from `left_m` to `right_m` along it, from `low_m` to `high_m` above it."""

    left_m: float
    right_m: float
    low_m: float
    high_m: float


@dataclass(frozen=True, slots=True)
class Face:
    """One side of a wall: `corner` low at its left for who looks at it, `along` to the right."""

    corner: Vector
    along: Vector
    facing: Vector

    def at(self, along_m: float, up_m: float, out_m: float = 0.0) -> Vector:
        """Return a point of the face, or `out_m` before it."""
        up = np.array([0.0, up_m, 0.0])
        return np.asarray(self.corner + along_m * self.along + up + out_m * self.facing)


@dataclass(frozen=True, slots=True)
class Box:
    """A room's inside: `left_m` to `right_m`, `near_m` to `far_m`, from the floor to `high_m`."""

    left_m: float
    right_m: float
    near_m: float
    far_m: float
    high_m: float

    @property
    def width_m(self) -> float:
        """Return the size along x."""
        return self.right_m - self.left_m

    @property
    def length_m(self) -> float:
        """Return the size along z."""
        return self.far_m - self.near_m

    def face(self, side: str) -> Face:
        """Return the inside of the wall at `side`: left, right, near or far."""
        x, z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
        corners = {
            "left": ((self.left_m, self.near_m), z, x),
            "right": ((self.right_m, self.far_m), -z, -x),
            "near": ((self.right_m, self.near_m), -x, z),
            "far": ((self.left_m, self.far_m), x, -z),
        }
        (right_m, ahead_m), along, facing = corners[side]
        return Face(np.array([right_m, 0.0, ahead_m]), along, facing)

    def run_m(self, side: str) -> float:
        """Return the length of the wall at `side`."""
        return self.length_m if side in ("left", "right") else self.width_m


def outside(face: Face, run_m: float) -> Face:
    """Return the other side of a wall whose inside is `run_m` long."""
    corner = face.at(run_m, 0.0, -_WALL_M)
    return Face(corner, -face.along, -face.facing)


def mirrored(opening: Opening, run_m: float) -> Opening:
    """Return an opening as it is seen from the other side."""
    return Opening(run_m - opening.right_m, run_m - opening.left_m, opening.low_m, opening.high_m)


class Builder:
    """Puts the pieces of buildings together."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.put = Assembly(rng)

    @property
    def quads(self) -> list[Quad]:
        """Return all that was put so far."""
        return self.put.quads

    def shade(self, low: float = 0.85, high: float = 1.1) -> Colour:
        """Return a tint that is not far from grey."""
        red, green, blue = (float(v) for v in self.rng.uniform(low, high, 3))
        return (red, green, blue)

    def grey(self, low: float, high: float) -> Colour:
        """Return a tint without colour."""
        value = float(self.rng.uniform(low, high))
        return (value, value, value)

    def paint(self) -> Colour:
        """Return a strong tint: of a chair, a book, a car."""
        hue = self.rng.uniform(0.0, 1.0)
        channel = np.clip(np.abs((hue * 6 + np.array([0.0, 4.0, 2.0])) % 6 - 3) - 1, 0.15, 1)
        red, green, blue = (float(v) for v in 0.4 + 1.1 * channel)
        return (red, green, blue)

    def panel(
        self,
        face: Face,
        part: Opening,
        material: Material,
        texels_per_m: float = _TEXELS_PER_M,
        out_m: float = 0.0,
        *,
        solid: bool = True,
    ) -> None:
        """Cover a rectangle of a face; its texture goes on from panel to panel."""
        tile = material.tile_m or (1.0, 1.0)
        for a0, a1 in _cuts(part.left_m, part.right_m):
            for h0, h1 in _cuts(part.low_m, part.high_m):
                around = ((a0, h0), (a1, h0), (a1, h1), (a0, h1))
                corners = [face.at(a, h, out_m) for a, h in around]
                begin = (a0 / tile[0], h0 / tile[1])
                self.put.quad(
                    corners, face.facing, material, texels_per_m, solid=solid, at_tile=begin
                )

    def wall(
        self,
        face: Face,
        run_m: float,
        high_m: float,
        material: Material,
        openings: Sequence[Opening] = (),
        texels_per_m: float = _TEXELS_PER_M,
    ) -> None:
        """Cover a face but for its openings, which do not overlap along it."""
        at_m = 0.0
        for hole in sorted(openings):
            self.panel(face, Opening(at_m, hole.left_m, 0.0, high_m), material, texels_per_m)
            above = Opening(hole.left_m, hole.right_m, hole.high_m, high_m)
            below = Opening(hole.left_m, hole.right_m, 0.0, hole.low_m)
            self.panel(face, above, material, texels_per_m)
            self.panel(face, below, material, texels_per_m)
            at_m = hole.right_m
        self.panel(face, Opening(at_m, run_m, 0.0, high_m), material, texels_per_m)

    def reveal(self, face: Face, hole: Opening, material: Material) -> None:
        """Line the four sides of an opening through the wall."""
        left, right, low, high = hole
        up, along = np.array([0.0, 1.0, 0.0]), face.along
        sides = (
            ((left, low), (left, high), along),
            ((right, low), (right, high), -along),
            ((left, low), (right, low), up),
            ((left, high), (right, high), -up),
        )
        for (a0, h0), (a1, h1), facing in sides:
            corners = [face.at(a0, h0), face.at(a1, h1), face.at(a1, h1, -_WALL_M),
                       face.at(a0, h0, -_WALL_M)]  # fmt: skip
            self.put.quad(corners, facing, material, _TEXELS_PER_M)

    def shell(
        self,
        room: Box,
        floor: Material,
        walls: Material,
        ceiling: Material,
        openings: dict[str, list[Opening]],
    ) -> None:
        """Build floor, ceiling and walls with skirting; openings are lined."""
        for z0, z1 in _cuts(room.near_m, room.far_m):
            for x0, x1 in _cuts(room.left_m, room.right_m):
                for up_m, material, facing in ((0.0, floor, 1.0), (room.high_m, ceiling, -1.0)):
                    tile = material.tile_m or (1.0, 1.0)
                    corners = [np.array([x, up_m, z]) for x, z in
                               ((x0, z0), (x1, z0), (x1, z1), (x0, z1))]  # fmt: skip
                    self.put.quad(corners, np.array([0.0, facing, 0.0]), material, _TEXELS_PER_M,
                                  at_tile=(x0 / tile[0], z0 / tile[1]))  # fmt: skip
        for side in ("left", "right", "near", "far"):
            face, run_m = room.face(side), room.run_m(side)
            holes = sorted(openings.get(side, []))
            self.wall(face, run_m, room.high_m, walls, holes)
            for hole in holes:
                self.reveal(face, hole, WHITE)
            free = [0.0, *(edge for h in holes if h.low_m < 0.1 for edge in h[:2]), run_m]
            for a0, a1 in zip(free[::2], free[1::2], strict=True):
                skirting = Opening(a0, a1, 0.0, 0.09)
                self.panel(face, skirting, WOOD, 2.0, 0.012, solid=False)

    def block(
        self,
        across: tuple[float, float],
        up: tuple[float, float],
        along: tuple[float, float],
        material: Material,
        *,
        top: Material | None = None,
        texels_per_m: float = 4.0,
    ) -> None:
        """Put a box without a bottom: x, y and z from and to."""
        self.put.box(STRAIGHT, along, across, up, material, texels_per_m, top=top)

    def on_face(self, face: Face, part: Opening, material: Material, out_m: float = 0.02) -> None:
        """Hang something flat on a face, its texture stretched over it."""
        around = ((part.left_m, part.low_m), (part.right_m, part.low_m),
                  (part.right_m, part.high_m), (part.left_m, part.high_m))  # fmt: skip
        corners = [face.at(a, h, out_m) for a, h in around]
        self.put.quad(corners, face.facing, material, 3.0, solid=False)

    def closed_door(self, face: Face, middle_m: float, tint: Colour) -> None:
        """Put a closed door with its frame and its number before a wall."""
        leaf = Opening(middle_m - 0.45, middle_m + 0.45, 0.0, 2.05)
        frame = Opening(leaf.left_m - 0.07, leaf.right_m + 0.07, 0.0, 2.12)
        self.on_face(face, frame, Material("steel", None, self.grey(0.5, 1.4)), 0.02)
        self.on_face(face, leaf, Material("door", None, tint), 0.04)
        plate = Opening(leaf.right_m + 0.15, leaf.right_m + 0.4, 1.45, 1.65)
        self.on_face(face, plate, self.poster(), 0.02)

    def poster(self) -> Material:
        """Return one of the posters in some colour."""
        return Material(f"poster{self.rng.integers(POSTERS)}", None, self.shade(0.6, 1.15))

    def hang(self, face: Face, middle_m: float, width_m: float, height_m: float) -> None:
        """Hang a poster at the height of the eyes."""
        low = 1.5 - 0.5 * height_m + float(self.rng.uniform(-0.1, 0.2))
        part = Opening(middle_m - width_m / 2, middle_m + width_m / 2, low, low + height_m)
        self.on_face(face, part, self.poster())

    def window(self, face: Face, hole: Opening, panes: int) -> None:
        """Put frame, bars and a sill into an opening; the glass itself is perfect."""
        bar = 0.06
        edges = np.linspace(hole.left_m, hole.right_m, panes + 1)
        uprights = [Opening(max(e - bar / 2, hole.left_m), min(e + bar / 2, hole.right_m),
                            hole.low_m, hole.high_m) for e in edges]  # fmt: skip
        across = [Opening(hole.left_m, hole.right_m, h, h + bar)
                  for h in (hole.low_m, hole.high_m - bar)]  # fmt: skip
        for part in (*uprights, *across):
            self.panel(face, part, WHITE, 3.0, -0.15)
        sill = [face.at(a, hole.low_m, out) for a, out in
                ((hole.left_m - 0.1, 0.0), (hole.right_m + 0.1, 0.0), (hole.right_m + 0.1, 0.2),
                 (hole.left_m - 0.1, 0.2))]  # fmt: skip
        self.put.quad(sill, np.array([0.0, 1.0, 0.0]), WHITE, 4.0)
        front = Opening(hole.left_m - 0.1, hole.right_m + 0.1, hole.low_m - 0.04, hole.low_m)
        self.panel(face, front, WHITE, 2.0, 0.2, solid=False)

    def ceiling_lamp(
        self, room: Box, middle: tuple[float, float], size: tuple[float, float], cd_m2: float
    ) -> None:
        """Put a lamp of `size` (x, z) into the ceiling; it shines down."""
        (x, z), (wide, deep) = middle, size
        up_m = room.high_m - 0.02
        corners = [np.array([x + a * wide / 2, up_m, z + b * deep / 2])
                   for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]  # fmt: skip
        down = np.array([0.0, -1.0, 0.0])
        self.put.quad(corners, down, LAMP, emitted_cd_m2=cd_m2, solid=False)

    def table(self, across: tuple[float, float], along: tuple[float, float]) -> None:
        """Put a table with legs and things on it."""
        self.block(across, (0.71, 0.75), along, WOOD, top=Material("keyboard", (1.4, 1.4)))
        for x in (across[0] + 0.03, across[1] - 0.08):
            for z in (along[0] + 0.03, along[1] - 0.08):
                self.block((x, x + 0.05), (0.0, 0.71), (z, z + 0.05), METAL, texels_per_m=2.0)

    def monitor(self, x: float, z: float, towards: float) -> None:
        """Put a screen on a table; it looks along z, back (-1) or ahead (+1)."""
        self.block((x - 0.3, x + 0.3), (0.85, 1.2), (z, z + 0.04), DARK)
        self.block((x - 0.03, x + 0.03), (0.75, 0.85), (z, z + 0.03), DARK, texels_per_m=2.0)
        front = z + (0.045 if towards > 0 else -0.005)
        corner = np.array([x + 0.3 * towards, 0.85, front])
        face = Face(corner, np.array([-towards, 0.0, 0.0]), np.array([0.0, 0.0, towards]))
        self.on_face(face, Opening(0.0, 0.6, 0.0, 0.35), Material("screen", None, self.shade(1, 3)))

    def chair(self, x: float, z: float, turn: float) -> None:
        """Put a chair whose back is at `turn` (-1 near, +1 far)."""
        seat = Material("cloth", (0.5, 0.5), self.paint())
        self.block((x - 0.23, x + 0.23), (0.42, 0.5), (z - 0.23, z + 0.23), seat)
        back = z + turn * 0.22
        self.block((x - 0.22, x + 0.22), (0.55, 1.0), (back - 0.03, back + 0.03), seat)
        self.block((x - 0.04, x + 0.04), (0.05, 0.42), (z - 0.04, z + 0.04), METAL)
        self.block((x - 0.25, x + 0.25), (0.0, 0.06), (z - 0.04, z + 0.04), DARK)

    def bookcase(self, face: Face, middle_m: float, width_m: float = 1.2) -> None:
        """Put a bookcase against a wall."""
        front = Opening(middle_m - width_m / 2, middle_m + width_m / 2, 0.0, 1.95)
        self._deep(face, front, 0.32, Material(f"shelf{self.rng.integers(SHELVES)}", None,
                                               self.shade(0.8, 1.2)))  # fmt: skip

    def cupboard(self, face: Face, middle_m: float, width_m: float, high_m: float) -> None:
        """Put a steel cupboard against a wall."""
        front = Opening(middle_m - width_m / 2, middle_m + width_m / 2, 0.0, high_m)
        self._deep(face, front, 0.45, Material("door", (width_m / 2, high_m), self.shade()))

    def _deep(self, face: Face, front: Opening, deep_m: float, material: Material) -> None:
        """Put a box against a wall: its front in a material, the rest in steel."""
        left, right, low, high = front
        around = ((left, low), (right, low), (right, high), (left, high))
        self.put.quad([face.at(a, h, deep_m) for a, h in around], face.facing, material, 4.0,
                      at_tile=(0.0, 0.0))  # fmt: skip
        for edge, away in ((left, -1.0), (right, 1.0)):
            side = [face.at(edge, h, out) for h, out in
                    ((low, 0.0), (low, deep_m), (high, deep_m), (high, 0.0))]  # fmt: skip
            self.put.quad(side, away * face.along, WHITE, 3.0)
        lid = [face.at(a, high, out) for a, out in
               ((left, 0.0), (right, 0.0), (right, deep_m), (left, deep_m))]  # fmt: skip
        self.put.quad(lid, np.array([0.0, 1.0, 0.0]), WHITE, 3.0)

    def plant(self, x: float, z: float, high_m: float, foot_m: float = 0.0) -> None:
        """Put a plant in a pot, or a small tree: crossed leaves."""
        self.block((x - 0.17, x + 0.17), (foot_m, foot_m + 0.32), (z - 0.17, z + 0.17),
                   Material("brick", (1.0, 1.0), self.shade(0.7, 1.3)))  # fmt: skip
        self.leaves(x, z, (foot_m + 0.3, foot_m + high_m), 0.45 * high_m)

    def tree(self, x: float, z: float, high_m: float) -> None:
        """Plant a tree."""
        self.block((x - 0.13, x + 0.13), (0.0, 0.55 * high_m), (z - 0.13, z + 0.13),
                   Material("dark", (0.6, 0.6)))  # fmt: skip
        self.leaves(x, z, (0.35 * high_m, high_m), 0.4 * high_m)

    def leaves(self, x: float, z: float, up: tuple[float, float], half_m: float) -> None:
        """Cross three sheets of leaves."""
        start = self.rng.uniform(0, math.pi)
        for k in range(3):
            angle = start + k * math.pi / 3
            side = half_m * np.array([math.cos(angle), 0.0, math.sin(angle)])
            facing = np.array([-math.sin(angle), 0.0, math.cos(angle)])
            middle = np.array([x, 0.0, z])
            corners = [middle + s * side + np.array([0.0, h, 0.0])
                       for s, h in ((-1, up[0]), (1, up[0]), (1, up[1]), (-1, up[1]))]  # fmt: skip
            self.put.quad(corners, facing, FOLIAGE, 2.0, cutout="leaves", solid=k == 0)


def _cuts(low: float, high: float) -> list[tuple[float, float]]:
    """Return a stretch in equal pieces of at most _PANEL_M, none for one without length."""
    if high - low < 1e-6:
        return []
    edges = np.linspace(low, high, max(1, math.ceil((high - low) / _PANEL_M)) + 1)
    return [(float(a), float(b)) for a, b in pairwise(edges)]
