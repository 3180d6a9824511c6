"""The world family `tunnel`: a bright street, a bent underpass, a bright street.

Arc length 0 is where the drive begins. Lengths are metres, offsets from the centreline positive
to the right; the vehicle keeps to the right lane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rig.drivers.scenes import materials
from rig.drivers.scenes.geometry import Quad
from rig.drivers.scenes.street import ROAD_HALF_M, Street, bays
from rig.drivers.scenes.textures import street_textures
from rig.drivers.scenes.trajectories import Bend, Knot, Path, paced
from rig.drivers.scenes.vehicle import shaken_drive
from rig.drivers.scenes.weather import Weather, daylight, draw_weather, world_rng
from rig.drivers.scenes.world import Plan

TUNNEL_VERSION = "tunnel/6"

_DRIVE_M = 12.0 * 13.9
_BEHIND_M = 40.0
_SEEN_AHEAD_M = 110.0
_END_M = _DRIVE_M + _SEEN_AHEAD_M
_PLAZA_M = 57.0


@dataclass(frozen=True, slots=True)
class Layout:
    """The numbers that a seed draws; `roughness` are shares of the usual shaking."""

    entrance_m: float
    exit_m: float
    bend: Bend
    weather: Weather
    lamp_cd_m2: float
    lamp_step_m: float
    rough_outside: float
    rough_inside: float
    slow_inside: float


def draw_layout(rng: np.random.Generator) -> Layout:
    """Return the layout of one world; the exit never stays in view from the entrance."""
    entrance = rng.uniform(35.0, 40.0)
    exit_ = entrance + rng.uniform(41.0, 44.0)
    turn = rng.choice([-1.0, 1.0]) / rng.uniform(38.0, 44.0)
    start = entrance + rng.uniform(-4.0, 2.0)
    bend = Bend(start, exit_ - start + rng.uniform(0.0, 6.0), turn)
    behind_driver = turn * bend.length_m + math.pi
    return Layout(
        entrance_m=entrance,
        exit_m=exit_,
        bend=bend,
        weather=draw_weather(rng, behind_driver),
        lamp_cd_m2=float(np.exp(rng.uniform(math.log(265e3), math.log(300e3)))),
        lamp_step_m=rng.uniform(5.0, 7.0),
        rough_outside=rng.uniform(4.0, 5.0),
        rough_inside=rng.uniform(0.15, 0.25),
        slow_inside=rng.uniform(0.53, 0.57),
    )


def tunnel(seed: int, split: str, speed_mps: float) -> Plan:
    """Return the plan of one tunnel world with a drive through it."""

    def rng(part: str) -> np.random.Generator:
        return world_rng("tunnel", split, seed, part)

    layout = draw_layout(rng("layout"))
    path = Path((layout.bend,), _BEHIND_M + _END_M)
    light = daylight(layout.weather, rng("sky"))
    return Plan(
        key=f"tunnel {split} {seed}",
        version=TUNNEL_VERSION,
        quads=_build(layout, Street(path, rng("objects"))),
        textures=lambda: street_textures(rng("textures")),
        sky=lambda: light.sky,
        sun=light.sun,
        drive=shaken_drive(
            rng("motion"),
            path,
            speed_mps,
            roughness=_roughness(layout),
            timetable=paced(speed_mps, _pace(layout), _END_M),
        ),
        drive_s=_DRIVE_M / speed_mps,
    )


def _roughness(layout: Layout) -> tuple[Knot, ...]:
    """Return rough paving outside and smooth asphalt in the underpass."""
    outside, inside = layout.rough_outside, layout.rough_inside
    return (
        Knot(layout.entrance_m - 3.0, outside),
        Knot(layout.entrance_m, inside),
        Knot(layout.exit_m, inside),
        Knot(layout.exit_m + 3.0, outside),
    )


def _pace(layout: Layout) -> tuple[Knot, ...]:
    """Return how much slower the vehicle takes the bend."""
    slow = layout.slow_inside
    return (
        Knot(layout.entrance_m - 10.0, 1.0),
        Knot(layout.entrance_m, slow),
        Knot(layout.exit_m, slow),
        Knot(layout.exit_m + 15.0, 1.0),
    )


def _build(layout: Layout, street: Street) -> list[Quad]:
    entrance, exit_ = layout.entrance_m, layout.exit_m
    for along in bays(-_BEHIND_M, entrance):
        street.ground(along, materials.STREET)
        street.patch(along[0])
    for index, along in enumerate(bays(entrance, exit_)):
        street.ground(along, materials.TUBE)
        street.patch(along[0])
        street.tube(along, pillars=index % 2 == 1)
        street.roof(along, 45.0)
    for along in bays(exit_, _END_M):
        street.ground(along, materials.PLAZA)
    for s_m in np.arange(entrance + 4.0, exit_ - 3.0, layout.lamp_step_m):
        street.lamps(float(s_m), layout.lamp_cd_m2)
    street.portal(entrance, -1.0, 40.0)
    street.portal(exit_, 1.0, 40.0)
    street.inner_signs(entrance + 2.0, exit_ - 3.0)
    street.van(street.rng.uniform(entrance + 8.0, exit_ - 12.0), -2.95)
    for side in (-1.0, 1.0):
        street.houses((-_BEHIND_M, entrance - 1.0), side)
        street.roadside((-25.0, entrance - 5.0), side)
        _blocks(street, (exit_ + 4.0, exit_ + _PLAZA_M - 20.0), side)
    _far_side(street, exit_ + _PLAZA_M)
    return street.quads


def _blocks(street: Street, along: tuple[float, float], side: float) -> None:
    """Put concrete blocks and plastered walls on the plaza."""
    s_m = along[0]
    while s_m < along[1]:
        street.bollard(s_m, side * (ROAD_HALF_M + street.rng.uniform(0.6, 9.0)))
        s_m += street.rng.uniform(4.5, 11.0)


def _far_side(street: Street, near_m: float) -> None:
    """Close the plaza with a row of white houses, lit by the sun, that look at the tunnel."""
    across = -70.0
    while across < 70.0:
        wide = street.rng.uniform(10.0, 20.0)
        up = (0.1, street.rng.uniform(9.0, 20.0))
        near = (near_m, near_m + 10.0)
        street.put.box(street.path, near, (across, across + wide), up, materials.WHITE)
        across += wide
