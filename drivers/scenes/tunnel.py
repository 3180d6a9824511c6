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
from rig.drivers.scenes.street import ROAD_HALF_M, Lighting, Street, bays, draw_lighting
from rig.drivers.scenes.textures import street_textures
from rig.drivers.scenes.trajectories import Bend, Knot, Path, paced
from rig.drivers.scenes.vehicle import shaken_drive
from rig.drivers.scenes.weather import Weather, daylight, draw_weather, world_rng
from rig.drivers.scenes.world import Plan

TUNNEL_VERSION = "tunnel/7"

_DRIVE_M = 12.0 * 13.9
_BEHIND_M = 40.0
_SEEN_AHEAD_M = 150.0
_END_M = _DRIVE_M + _SEEN_AHEAD_M
_SQUARE_M = 60.0
_FAR_SIDE_M = 95.0


@dataclass(frozen=True, slots=True)
class Layout:
    """The numbers that a seed draws; `rough_...` are shares of the usual shaking."""

    entrance_m: float
    exit_m: float
    bend: Bend
    weather: Weather
    lighting: Lighting
    rough_street: float
    rough_square: float
    rough_inside: float
    slow_inside: float


def draw_layout(rng: np.random.Generator) -> Layout:
    """Return the layout of one world; the exit never stays in view from the entrance."""
    entrance = rng.uniform(35.0, 37.0)
    exit_ = entrance + rng.uniform(78.0, 82.0)
    turn = rng.choice([-1.0, 1.0]) / rng.uniform(72.0, 82.0)
    start = entrance + rng.uniform(-4.0, 2.0)
    bend = Bend(start, exit_ - start + rng.uniform(0.0, 6.0), turn)
    behind_driver = turn * bend.length_m + math.pi
    return Layout(
        entrance_m=entrance,
        exit_m=exit_,
        bend=bend,
        weather=draw_weather(rng, behind_driver, 18.0),
        lighting=draw_lighting(rng, entrance, exit_),
        rough_street=rng.uniform(5.0, 6.0),
        rough_square=rng.uniform(6.0, 7.0),
        rough_inside=rng.uniform(0.2, 0.3),
        slow_inside=rng.uniform(0.86, 0.89),
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
    """Return worn paving on the street, smooth asphalt in the underpass, setts on the square."""
    return (
        Knot(layout.entrance_m - 3.0, layout.rough_street),
        Knot(layout.entrance_m, layout.rough_inside),
        Knot(layout.exit_m, layout.rough_inside),
        Knot(layout.exit_m + 3.0, layout.rough_square),
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
        street.ground(along, materials.SQUARE)
    street.lamps(layout.lighting)
    street.portal(entrance, -1.0, 40.0)
    street.portal(exit_, 1.0, 40.0)
    street.inner_signs(entrance + 2.0, exit_ - 3.0)
    street.van(street.rng.uniform(entrance + 8.0, exit_ - 12.0), -2.95)
    for side in (-1.0, 1.0):
        street.houses((-_BEHIND_M, entrance - 1.0), side)
        street.roadside((-25.0, entrance - 5.0), side)
        _blocks(street, (exit_ + 4.0, exit_ + _SQUARE_M), side)
    _far_side(street, exit_ + _FAR_SIDE_M)
    return street.quads


def _blocks(street: Street, along: tuple[float, float], side: float) -> None:
    """Put concrete blocks and plastered walls on the square."""
    s_m = along[0]
    while s_m < along[1]:
        street.bollard(s_m, side * (ROAD_HALF_M + street.rng.uniform(0.6, 9.0)))
        s_m += street.rng.uniform(9.0, 18.0)


def _far_side(street: Street, near_m: float) -> None:
    """Close the square with a row of houses, lit by the sun, that look at the tunnel."""
    across = -70.0
    while across < 70.0:
        wide = street.rng.uniform(10.0, 20.0)
        up = (0.0, street.rng.uniform(12.0, 13.0))
        near = (near_m, near_m + 10.0)
        street.put.box(street.path, near, (across, across + wide), up, materials.WHITE)
        across += wide
