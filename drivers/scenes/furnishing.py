"""How rooms are furnished: what stands at walls and hangs from ceilings."""

from __future__ import annotations

import numpy as np

from rig.drivers.scenes.geometry import Colour, Material
from rig.drivers.scenes.rooms import Box, Builder, Opening

FLOORS = (
    Material("linoleum", (2.0, 2.0), (1.0, 0.97, 0.9), 0.11),
    Material("tiles", (1.8, 1.8), (1.0, 0.98, 0.95), 0.13),
    Material("carpet", (1.5, 1.5), (1.1, 1.0, 1.2), 0.17),
    Material("parquet", (1.6, 1.6), (1.15, 0.95, 0.7), 0.13),
)
CEILING = Material("ceiling", (2.4, 2.4))


def plaster(rng: np.random.Generator) -> Material:
    """Return the walls of one room: white to grey, with a breath of colour; albedo 0.45 to 0.75."""
    light = float(rng.uniform(0.48, 0.8))
    red, green, blue = (light * float(v) for v in rng.uniform(0.9, 1.06, 3))
    return Material("plaster", (2.6, 2.6), (red, green, blue))


def beside(build: Builder, room: Box, side: str, along: float, doors: Colour) -> None:
    """Put one thing at a wall of a corridor."""
    rng, face = build.rng, room.face(side)
    kind = rng.random()
    if kind < 0.4:
        build.closed_door(face, along, doors)
    elif kind < 0.75:
        build.hang(face, along, float(rng.uniform(0.5, 0.9)), float(rng.uniform(0.6, 1.1)))
    elif kind < 0.88:
        board = Opening(along - 0.7, along + 0.7, 1.0, 1.9)
        build.on_face(face, board, Material("notices", None, build.shade(0.9, 1.1)))
    else:
        x = (room.left_m + 0.3) if side == "left" else (room.right_m - 0.3)
        z = along if side == "left" else room.length_m - along
        build.plant(x, z, float(rng.uniform(1.0, 1.5)))


def against(build: Builder, room: Box, side: str, along: float) -> None:
    """Put one thing against the wall of a room."""
    rng, face = build.rng, room.face(side)
    kind = rng.random()
    if kind < 0.35:
        build.bookcase(face, along)
    elif kind < 0.55:
        build.cupboard(face, along, 1.0, float(rng.uniform(1.2, 2.0)))
    elif kind < 0.85:
        build.hang(face, along, float(rng.uniform(0.5, 0.9)), float(rng.uniform(0.7, 1.1)))


def ceiling_grid(build: Builder, room: Box, cd_m2: float) -> None:
    """Hang lamps in a grid; a share of them is off."""
    for z in np.arange(room.near_m + 1.6, room.far_m - 0.8, 2.6):
        for x in np.arange(room.left_m + 1.5, room.right_m - 1.0, 2.6):
            if build.rng.random() < 0.85:
                build.ceiling_lamp(room, (float(x), float(z)), (0.6, 1.2), cd_m2)
