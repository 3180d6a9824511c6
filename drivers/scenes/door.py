"""The world family `door`: a camera stands in a lobby while its door to the outside opens.

Thesis 4.2.2 and figure 4.4b: the opening grows from pose to pose, and the light with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rig.drivers.scenes.daylight import draw_daylight
from rig.drivers.scenes.furnishing import CEILING, FLOORS, against, plaster
from rig.drivers.scenes.geometry import Colour, Material, Quad
from rig.drivers.scenes.interiors import room_textures
from rig.drivers.scenes.light import ROOM_RAYS
from rig.drivers.scenes.motions import DRIVE_S, read_motion, robot_drive
from rig.drivers.scenes.outdoors import surroundings
from rig.drivers.scenes.rooms import Box, Builder, Face, Opening
from rig.drivers.scenes.trajectories import Vector
from rig.drivers.scenes.weather import world_rng
from rig.drivers.scenes.world import Change, Plan

DOOR_VERSION = "door/2"
OPTIONS = ("motion",)
SPEED_MPS = 0.35

_STAGES = 7
_GAP_M = 0.001
_THICK_M = 0.045


@dataclass(frozen=True, slots=True)
class Leaf:
    """A door that turns about its left edge in `hole`, by up to `open_rad`.

    It opens towards who looks at the face (`out` +1) or away (-1).
    """

    face: Face
    hole: Opening
    out: float
    open_rad: float
    tint: Colour

    def quads(self, share: float) -> list[Quad]:
        """Return front, back and edges of the leaf when it is open by a share, 0 to 1."""
        depth_m = -0.02 if self.out > 0 else -0.25
        hinge = self.face.at(self.hole.left_m + _GAP_M, 0.0, depth_m)
        angle = share * self.open_rad
        along = math.cos(angle) * self.face.along + self.out * math.sin(angle) * self.face.facing
        facing = math.cos(angle) * self.face.facing - self.out * math.sin(angle) * self.face.along
        wide = self.hole.right_m - self.hole.left_m - 2 * _GAP_M
        high = self.hole.high_m - _GAP_M

        def at(a: float, h: float, out: float) -> Vector:
            return np.asarray(hinge + a * along + np.array([0.0, h, 0.0]) + out * facing)

        skin = Material("door", None, self.tint)
        edge = Material("wood", (1.2, 1.2), self.tint)
        faces = (
            ([at(0, 0, 0), at(wide, 0, 0), at(wide, high, 0), at(0, high, 0)], facing, skin),
            ([at(0, 0, -_THICK_M), at(wide, 0, -_THICK_M), at(wide, high, -_THICK_M),
              at(0, high, -_THICK_M)], -facing, skin),
            ([at(wide, 0, 0), at(wide, 0, -_THICK_M), at(wide, high, -_THICK_M),
              at(wide, high, 0)], along, edge),
            ([at(0, high, 0), at(wide, high, 0), at(wide, high, -_THICK_M),
              at(0, high, -_THICK_M)], np.array([0.0, 1.0, 0.0]), edge),
        )  # fmt: skip
        return [Quad(np.array(c), f, material, 6.0) for c, f, material in faces]


@dataclass(frozen=True, slots=True)
class Swing:
    """When a door opens, and perhaps closes again: times in seconds."""

    opens_s: float
    opened_s: float
    closes_s: float
    closed_s: float

    def share(self, time_s: float) -> float:
        """Return how far the door is open, 0 to 1; it starts and stops smoothly."""
        opened = _smooth((time_s - self.opens_s) / (self.opened_s - self.opens_s))
        closed = _smooth((time_s - self.closes_s) / (self.closed_s - self.closes_s))
        return opened - closed


def _smooth(share: float) -> float:
    inside = min(max(share, 0.0), 1.0)
    return inside * inside * (3.0 - 2.0 * inside)


def draw_swing(rng: np.random.Generator) -> Swing:
    """Return a door that opens within 3 to 7 s; in a third of the worlds it closes again."""
    opens = float(rng.uniform(1.0, 2.5))
    opened = opens + float(rng.uniform(3.0, 5.0) if rng.random() < 0.5 else rng.uniform(5.0, 7.0))
    again = rng.random() < 1 / 3
    closes = min(opened + 0.5, 9.0) if again else DRIVE_S + 1.0
    return Swing(opens, min(opened, 8.5), closes, closes + float(rng.uniform(2.0, 4.0)))


def door(seed: int, split: str, speed_mps: float, options: Mapping[str, str]) -> Plan:
    """Return the plan of one door; raises UsageError for an unknown motion."""

    def rng(part: str) -> np.random.Generator:
        return world_rng("door", split, seed, part)

    motion = read_motion("door", options.get("motion", "stationary"))
    build = Builder(rng("layout"))
    room, leaf = _lobby(build)
    day = draw_daylight(rng("daylight"))
    surroundings(build, room)
    still = tuple(build.quads)
    swing = draw_swing(rng("swing"))

    def quads(share: float) -> Sequence[Quad]:
        return [*still, *leaf.quads(share)]

    move = rng("motion")
    return Plan(
        key=f"door {split} {seed} {day.words}",
        version=DOOR_VERSION,
        quads=quads(0.0),
        textures=lambda: room_textures(rng("textures")),
        sky=lambda: day.sky,
        sun=day.sun,
        drive=robot_drive(
            move,
            motion,
            speed_mps,
            float(move.uniform(0.4, 1.0)),
            float(move.uniform(1.1, 1.5)),
            right_m=float(move.uniform(-0.5, 0.5)),
            pan_rad=math.radians(40.0),
        ),
        drive_s=DRIVE_S,
        rays=ROOM_RAYS,
        change=Change(quads, swing.share, _STAGES),
    )


def _lobby(build: Builder) -> tuple[Box, Leaf]:
    """Build a lobby with a door in the wall ahead, some furniture, and few lamps."""
    rng = build.rng
    half = float(rng.uniform(1.7, 2.8))
    room = Box(-half, half, 0.0, float(rng.uniform(5.5, 8.0)), float(rng.uniform(2.5, 3.0)))
    middle = half + float(rng.uniform(-0.4, 0.4))
    wide = float(rng.uniform(0.95, 1.5))
    hole = Opening(middle - wide / 2, middle + wide / 2, 0.0, float(rng.uniform(2.05, 2.3)))
    build.shell(room, FLOORS[rng.integers(4)], plaster(rng), CEILING, {"far": [hole]})
    for side in ("left", "right"):
        for along in np.arange(1.2, room.length_m - 0.8, 1.5):
            against(build, room, side, float(along))
    far = room.face("far")
    build.hang(far, (hole.left_m - 0.1) / 2, min(0.7, hole.left_m - 0.4), 0.9)
    build.hang(far, (hole.right_m + 0.1 + room.width_m) / 2, 0.6, 0.8)
    if rng.random() < 0.6:
        build.plant(room.right_m - 0.4, room.far_m - 0.5, float(rng.uniform(1.0, 1.6)))
    lamp_cd_m2 = float(np.exp(rng.uniform(math.log(400.0), math.log(3500.0))))
    for z in np.arange(1.3, room.length_m - 0.8, float(rng.uniform(2.0, 3.0))):
        build.ceiling_lamp(room, (0.0, float(z)), (0.3, 1.2), lamp_cd_m2)
    out = float(rng.choice([-1.0, 1.0]))
    open_rad = math.radians(float(rng.uniform(80.0, 110.0)))
    return room, Leaf(far, hole, out, open_rad, build.shade(0.5, 1.3))
