"""The world family `doorway`: out of one building, across a courtyard, into the next one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rig.drivers.scenes.daylight import draw_daylight
from rig.drivers.scenes.furnishing import CEILING, FLOORS, beside, plaster
from rig.drivers.scenes.geometry import Material
from rig.drivers.scenes.interiors import room_textures
from rig.drivers.scenes.light import ROOM_RAYS
from rig.drivers.scenes.motions import DRIVE_S, read_motion, robot_drive
from rig.drivers.scenes.outdoors import surroundings
from rig.drivers.scenes.rooms import WOOD, Box, Builder, Face, Opening, mirrored, outside
from rig.drivers.scenes.weather import world_rng
from rig.drivers.scenes.world import Plan

DOORWAY_VERSION = "doorway/2"
OPTIONS = ("motion",)
SPEED_MPS = 1.4

_WALL_M = 0.3
_BRICK = Material("brick", (1.6, 1.6), (1.35, 0.85, 0.65), 0.09)
_RENDER = Material("plaster", (2.6, 2.6), (0.65, 0.6, 0.5), 0.05)
_PAVERS = Material("pavers", (2.4, 2.4), (1.1, 1.05, 0.98), 0.1)
_PANE = Material("dark", None, (0.9, 1.15, 1.5))
_GRAVEL = Material("gravel", (1.6, 1.6), (1.05, 1.0, 0.9), 0.05)


@dataclass(frozen=True, slots=True)
class Layout:
    """The numbers that a seed draws: both halls, their doors, and where a camera begins."""

    first: Box
    second: Box
    exit: Opening
    entry: Opening
    facade_m: float
    start_m: float


def draw_layout(rng: np.random.Generator) -> Layout:
    """Return a layout: about 5 m inside, 5 to 7 m under the sky, then inside again."""
    first_half, second_half = (float(v) for v in rng.uniform(1.1, 1.7, 2))
    first_m, yard_m = float(rng.uniform(8.0, 10.0)), float(rng.uniform(5.0, 7.0))
    first = Box(-first_half, first_half, 0.0, first_m, float(rng.uniform(2.5, 3.1)))
    begin = first_m + yard_m + 2 * _WALL_M
    second = Box(
        -second_half, second_half, begin, begin + float(rng.uniform(16.0, 20.0)),
        float(rng.uniform(2.5, 3.1)),
    )  # fmt: skip
    return Layout(
        first=first,
        second=second,
        exit=_door(rng, first_half),
        entry=_door(rng, second_half),
        facade_m=float(rng.uniform(4.5, 8.0)),
        start_m=first_m - float(rng.uniform(4.5, 5.5)),
    )


def _door(rng: np.random.Generator, half_m: float) -> Opening:
    wide = float(rng.uniform(1.3, 1.9))
    return Opening(half_m - wide / 2, half_m + wide / 2, 0.0, float(rng.uniform(2.1, 2.4)))


def doorway(seed: int, split: str, speed_mps: float, options: Mapping[str, str]) -> Plan:
    """Return the plan of one doorway; raises UsageError for an unknown motion."""

    def rng(part: str) -> np.random.Generator:
        return world_rng("doorway", split, seed, part)

    motion = read_motion("doorway", options.get("motion", "linear"))
    layout = draw_layout(rng("layout"))
    build = Builder(rng("objects"))
    _hall(build, layout.first, {"far": [layout.exit]})
    _hall(build, layout.second, {"near": [layout.entry]})
    _facades(build, layout)
    _yard(build, layout)
    day = draw_daylight(rng("daylight"))
    whole = Box(-9.0, 9.0, layout.first.near_m, layout.second.far_m, 3.0)
    surroundings(build, whole)
    move = rng("motion")
    return Plan(
        key=f"doorway {split} {seed} {day.words}",
        version=DOORWAY_VERSION,
        quads=build.quads,
        textures=lambda: room_textures(rng("textures")),
        sky=lambda: day.sky,
        sun=day.sun,
        drive=robot_drive(
            move,
            motion,
            speed_mps,
            _start_m(layout, motion),
            float(move.uniform(1.0, 1.4)),
            pan_rad=math.radians(165.0),
            pan_hz=0.5 / DRIVE_S,
        ),
        drive_s=DRIVE_S,
        rays=ROOM_RAYS,
    )


def _start_m(layout: Layout, motion: str) -> float:
    """Return where a camera begins.

    One that turns stands outside, so that it looks back into the dim hall in the middle of its
    drive; one that stands looks out from the hall.
    """
    out_m = {"linear": layout.start_m - layout.first.far_m, "rotating": 2.0, "stationary": -3.0}
    return layout.first.far_m + out_m[motion]


def _hall(build: Builder, room: Box, openings: dict[str, list[Opening]]) -> None:
    rng = build.rng
    build.shell(room, FLOORS[rng.integers(4)], plaster(rng), CEILING, openings)
    doors = build.shade(0.7, 1.2)
    for side in ("left", "right"):
        along = float(rng.uniform(0.8, 1.6))
        while along < room.length_m - 0.9:
            beside(build, room, side, along, doors)
            along += float(rng.uniform(1.3, 2.4))
    lamp_cd_m2 = float(rng.uniform(1500.0, 4500.0))
    for z in np.arange(room.near_m + 1.3, room.far_m - 1.0, float(rng.uniform(2.4, 4.0))):
        if rng.random() < 0.85:
            build.ceiling_lamp(room, (0.0, float(z)), (0.3, 1.2), lamp_cd_m2)


def _facades(build: Builder, layout: Layout) -> None:
    """Build what the courtyard sees of both buildings, with the leaves of their doors open."""
    sides = ((layout.first, "far", layout.exit), (layout.second, "near", layout.entry))
    for room, side, door in sides:
        inner = room.face(side)
        face, hole = outside(inner, room.run_m(side)), mirrored(door, room.run_m(side))
        stone = (_BRICK, _RENDER)[build.rng.integers(2)]
        build.wall(face, room.run_m(side), layout.facade_m, stone, [hole], 3.0)
        for low, high in ((-9.0, 0.0), (room.run_m(side), room.run_m(side) + 9.0)):
            _wing(build, face, Opening(low, high, 0.0, layout.facade_m), stone)
        lintel = Opening(hole.left_m, hole.right_m, hole.high_m + 0.15, hole.high_m + 0.55)
        build.on_face(face, lintel, build.poster(), 0.04)
        leaf_paint = Material("door", None, build.shade(0.6, 1.3))
        for edge, towards in ((hole.left_m, -1.0), (hole.right_m, 1.0)):
            leaf = 0.5 * (hole.right_m - hole.left_m)
            part = sorted((edge, edge + towards * leaf))
            opened = Opening(part[0], part[1], 0.02, hole.high_m)
            build.on_face(face, opened, leaf_paint, 0.06)


def _wing(build: Builder, face: Face, part: Opening, stone: Material) -> None:
    """Put a stretch of facade with windows beside a door."""
    rng = build.rng
    build.panel(face, part, stone, 2.0)
    for along in np.arange(part.left_m + 1.2, part.right_m - 1.2, float(rng.uniform(2.0, 2.8))):
        for low in np.arange(0.9, part.high_m - 1.7, 2.9):
            pane = Opening(float(along), float(along) + 1.2, float(low), float(low) + 1.4)
            build.on_face(face, pane, Material("steel", None, (1.6, 1.6, 1.6)), 0.02)
            inner = Opening(pane.left_m + 0.08, pane.right_m - 0.08, low + 0.08, low + 1.32)
            build.on_face(face, inner, _PANE, 0.03)


def _yard(build: Builder, layout: Layout) -> None:
    """Pave the courtyard and furnish it: benches, planters, trees."""
    rng = build.rng
    z0, z1 = layout.first.far_m + _WALL_M, layout.second.near_m - _WALL_M
    ground = (_PAVERS, _GRAVEL)[rng.integers(2)]
    for x in np.arange(-9.0, 9.0, 2.25):
        for low, high in ((z0, (z0 + z1) / 2), ((z0 + z1) / 2, z1)):
            material = _PAVERS if abs(x + 1.1) < 1.6 else ground
            corners = [np.array([a, 0.0, b]) for a, b in
                       ((x, low), (x + 2.25, low), (x + 2.25, high), (x, high))]  # fmt: skip
            tile = material.tile_m or (1.0, 1.0)
            build.put.quad(corners, np.array([0.0, 1.0, 0.0]), material, 5.0,
                           at_tile=(float(x) / tile[0], float(low) / tile[1]))  # fmt: skip
    for side in (-1.0, 1.0):
        for z in np.arange(z0 + 0.8, z1 - 0.6, 1.7):
            x = side * float(rng.uniform(2.2, 6.5))
            kind = rng.random()
            if kind < 0.35:
                build.plant(x, float(z), float(rng.uniform(1.2, 2.4)))
            elif kind < 0.6:
                build.block((x - 0.9, x + 0.9), (0.0, 0.45), (float(z), float(z) + 0.4), WOOD)
            elif kind < 0.8:
                build.tree(x, float(z), float(rng.uniform(3.0, 6.0)))
    for side in (-1.0, 1.0):
        x = side * 9.0
        low, high = sorted((x, x + side * 0.3))
        fence = Material("brick", (1.6, 1.6), build.shade(0.8, 1.3), 0.09)
        build.block((low, high), (0.0, float(rng.uniform(1.2, 2.6))), (z0, z1), fence)
