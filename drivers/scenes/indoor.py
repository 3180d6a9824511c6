"""The world family `indoor`: a hallway, a laboratory, a room with a window (thesis table 4.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rig.core.errors import UsageError
from rig.drivers.scenes.daylight import draw_daylight
from rig.drivers.scenes.furnishing import CEILING, FLOORS, against, beside, ceiling_grid, plaster
from rig.drivers.scenes.geometry import Material
from rig.drivers.scenes.interiors import room_textures
from rig.drivers.scenes.light import ROOM_RAYS
from rig.drivers.scenes.motions import DRIVE_S, read_motion, robot_drive
from rig.drivers.scenes.outdoors import surroundings
from rig.drivers.scenes.rooms import Box, Builder, Opening
from rig.drivers.scenes.weather import world_rng
from rig.drivers.scenes.world import Plan

INDOOR_VERSION = "indoor/2"
OPTIONS = ("place", "motion")
SPEED_MPS = 1.0


@dataclass(frozen=True, slots=True)
class Place:
    """A place of the family: the room that is drawn, and how it is furnished.

    `start_m` is where a camera begins, `speed` how fast it goes as a share of the walking speed.
    """

    draw: Callable[[np.random.Generator], Box]
    furnish: Callable[[Builder, Box], None]
    start_m: float
    speed: float


def indoor(seed: int, split: str, speed_mps: float, options: Mapping[str, str]) -> Plan:
    """Return the plan of one room; raises UsageError for an unknown place or motion."""

    def rng(part: str) -> np.random.Generator:
        return world_rng("indoor", split, seed, part)

    names = sorted(PLACES)
    name = options.get("place", str(rng("place").choice(names)))
    if name not in PLACES:
        raise UsageError(f"sim:indoor: place must be {', '.join(names)}, got {name!r}")
    motion = read_motion("indoor", options.get("motion", "linear"))
    place = PLACES[name]
    draw = rng(f"layout {name}")
    room = place.draw(draw)
    build = Builder(draw)
    place.furnish(build, room)
    day = draw_daylight(rng("daylight"))
    surroundings(build, room)
    move = rng("motion")
    return Plan(
        key=f"indoor {name} {split} {seed} {day.words}",
        version=INDOOR_VERSION,
        quads=build.quads,
        textures=lambda: room_textures(rng("textures")),
        sky=lambda: day.sky,
        sun=day.sun,
        drive=robot_drive(
            move,
            motion,
            place.speed * speed_mps,
            place.start_m,
            float(move.uniform(1.0, 1.4)),
            right_m=float(move.uniform(-0.2, 0.2)),
        ),
        drive_s=DRIVE_S,
        rays=ROOM_RAYS,
    )


def _hallway_box(rng: np.random.Generator) -> Box:
    half = float(rng.uniform(0.95, 1.35))
    return Box(-half, half, 0.0, float(rng.uniform(22.0, 28.0)), float(rng.uniform(2.5, 3.0)))


def _hallway(build: Builder, room: Box) -> None:
    """Furnish a corridor: doors, posters, few lamps, a window at its end and some at one side."""
    rng = build.rng
    lit = str(rng.choice(["left", "right"]))
    panes = [Opening(at, at + float(rng.uniform(1.0, 1.8)), 0.9, 2.2)
             for at in rng.uniform(5.0, 18.0, 4) if rng.random() < 0.5]  # fmt: skip
    windows = [hole for k, hole in enumerate(sorted(panes))
               if k == 0 or hole.left_m > sorted(panes)[k - 1].right_m + 0.4]  # fmt: skip
    end = Opening(room.width_m / 2 - 0.6, room.width_m / 2 + 0.6, 0.9, 2.2)
    walls = plaster(rng)
    floor = FLOORS[rng.integers(3)]
    build.shell(room, floor, walls, CEILING, {lit: windows, "far": [end]})
    for side, holes in ((lit, windows), ("far", [end])):
        for hole in holes:
            build.window(room.face(side), hole, 2)
    dado = Material("plaster", (2.6, 2.6), build.shade(0.25, 0.6))
    doors = build.shade(0.7, 1.2)
    for side in ("left", "right"):
        face, run_m = room.face(side), room.run_m(side)
        if rng.random() < 0.5:
            build.panel(face, Opening(0.0, run_m, 0.09, 0.85), dado, 3.0, 0.005, solid=False)
        along = float(rng.uniform(1.0, 3.0))
        while along < run_m - 1.5:
            free = not (side == lit and any(h.left_m - 1 < along < h.right_m + 1 for h in windows))
            if free:
                beside(build, room, side, along, doors)
            along += float(rng.uniform(1.5, 3.0))
    lamp_cd_m2 = float(rng.uniform(1500.0, 4500.0))
    step_m = float(rng.uniform(2.6, 4.6))
    for z in np.arange(1.5, room.length_m - 1.0, step_m):
        if rng.random() < 0.85:
            build.ceiling_lamp(room, (0.0, float(z)), (0.3, 1.2), lamp_cd_m2)


def _lab_box(rng: np.random.Generator) -> Box:
    half = float(rng.uniform(3.6, 4.8))
    return Box(-half, half, 0.0, float(rng.uniform(11.5, 14.0)), float(rng.uniform(2.8, 3.3)))


def _lab(build: Builder, room: Box) -> None:
    """Furnish a laboratory: rows of tables with screens, shelves, a whiteboard, windows."""
    rng = build.rng
    lit = str(rng.choice(["left", "right"]))
    count = int(rng.integers(2, 5))
    edges = np.linspace(1.0, room.length_m - 1.0, count + 1)
    windows = [Opening(a + 0.25, b - 0.25, 1.0, room.high_m - 0.4)
               for a, b in pairwise(edges)]  # fmt: skip
    build.shell(room, FLOORS[rng.integers(2)], plaster(rng), CEILING, {lit: windows})
    for hole in windows:
        build.window(room.face(lit), hole, 3)
    _work_places(build, room)
    dark = "left" if lit == "right" else "right"
    for along in np.arange(1.2, room.length_m - 1.0, 1.5):
        against(build, room, dark, float(along))
    far = room.face("far")
    board = float(rng.uniform(2.0, room.width_m - 2.0))
    build.on_face(far, Opening(board - 1.2, board + 1.2, 0.9, 2.1), Material("whiteboard", None))
    build.hang(far, 0.7 if board > room.width_m / 2 else room.width_m - 0.7, 0.8, 1.1)
    ceiling_grid(build, room, float(rng.uniform(1500.0, 4000.0)))


def _work_places(build: Builder, room: Box) -> None:
    """Put tables with screens and chairs left and right of an aisle."""
    rng = build.rng
    for z in np.arange(2.6, room.length_m - 1.6, float(rng.uniform(2.0, 2.6))):
        for side in (-1.0, 1.0):
            inner, outer = side * 0.85, side * (room.width_m / 2 - 0.9)
            low, high = sorted((inner, outer))
            build.table((low, high), (float(z), float(z) + 0.75))
            for x in np.arange(low + 0.5, high - 0.3, 1.3):
                if rng.random() < 0.8:
                    build.monitor(float(x), float(z) + 0.35, float(rng.choice([-1.0, 1.0])))
                if rng.random() < 0.7:
                    build.chair(float(x), float(z) - 0.45, -1.0)


def _window_box(rng: np.random.Generator) -> Box:
    half = float(rng.uniform(2.4, 3.4))
    return Box(-half, half, 0.0, float(rng.uniform(8.5, 10.5)), float(rng.uniform(2.6, 3.1)))


def _window(build: Builder, room: Box) -> None:
    """Furnish an office that is lit by its window: it fills much of the wall ahead."""
    rng = build.rng
    share = float(rng.uniform(0.4, 0.85))
    middle = room.width_m / 2 + float(rng.uniform(-0.3, 0.3))
    half = share * room.width_m / 2 - 0.35
    hole = Opening(middle - half, middle + half, float(rng.uniform(0.5, 0.95)), room.high_m - 0.3)
    build.shell(room, FLOORS[rng.integers(4)], plaster(rng), CEILING, {"far": [hole]})
    build.window(room.face("far"), hole, int(rng.integers(2, 5)))
    for side in ("left", "right"):
        for along in np.arange(1.0, room.length_m - 1.5, 1.5):
            against(build, room, side, float(along))
    near = room.face("near")
    build.closed_door(near, room.width_m / 2, build.shade(0.7, 1.2))
    hand = float(rng.choice([-1.0, 1.0]))
    desk = sorted((hand * 0.7, hand * (room.width_m / 2 - 0.5)))
    z = room.far_m - float(rng.uniform(2.2, 3.2))
    build.table((desk[0], desk[1]), (z, z + 0.8))
    build.monitor(hand * 1.2, z + 0.35, -1.0)
    build.chair(hand * 1.3, z - 0.45, -1.0)
    build.plant(-hand * (room.width_m / 2 - 0.5), room.far_m - 0.5, float(rng.uniform(1.1, 1.7)))
    if rng.random() < 0.6:
        ceiling_grid(build, room, float(rng.uniform(300.0, 1500.0)))


PLACES: Mapping[str, Place] = {
    "hallway": Place(_hallway_box, _hallway, 0.6, 1.1),
    "lab": Place(_lab_box, _lab, 0.5, 0.55),
    "window": Place(_window_box, _window, 0.5, 0.4),
}
