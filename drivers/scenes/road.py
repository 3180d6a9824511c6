"""The world family `road`: an open, bending road in steady daylight."""

from __future__ import annotations

import math

import numpy as np

from rig.drivers.scenes import materials
from rig.drivers.scenes.geometry import Quad
from rig.drivers.scenes.street import LANE_M, Street, bays
from rig.drivers.scenes.textures import street_textures
from rig.drivers.scenes.trajectories import Bend, Knot, Path
from rig.drivers.scenes.vehicle import shaken_drive
from rig.drivers.scenes.weather import daylight, draw_weather, world_rng
from rig.drivers.scenes.world import Plan

ROAD_VERSION = "road/3"

_DRIVE_M = 12.0 * 13.9
_PACE = (0.9, 1.1)
_BEHIND_M = 40.0
_END_M = _DRIVE_M + 120.0


def road(seed: int, split: str, speed_mps: float) -> Plan:
    """Return the plan of one open road with a drive along it.

    Drives last as long in every world; how fast they are, and so how far they go, differs.
    """

    def rng(part: str) -> np.random.Generator:
        return world_rng("road", split, seed, part)

    drawn = rng("layout")
    path = Path(_draw_bends(drawn), _BEHIND_M + _END_M)
    light = daylight(draw_weather(drawn, math.pi), rng("sky"))
    roughness = (Knot(0.0, drawn.uniform(0.8, 1.6)),)
    driven_mps = speed_mps * drawn.uniform(*_PACE)
    return Plan(
        key=f"road {split} {seed}",
        version=ROAD_VERSION,
        quads=_build(Street(path, rng("objects"))),
        textures=lambda: street_textures(rng("textures")),
        sky=lambda: light.sky,
        sun=light.sun,
        drive=shaken_drive(rng("motion"), path, driven_mps, roughness=roughness),
        drive_s=_DRIVE_M / speed_mps,
    )


def _draw_bends(rng: np.random.Generator) -> list[Bend]:
    """Return two or three gentle bends, far enough apart."""
    starts = np.arange(20.0, 240.0, rng.uniform(70.0, 100.0))
    return [
        Bend(float(start), rng.uniform(35.0, 60.0), rng.choice([-1.0, 1.0]) / rng.uniform(110, 200))
        for start in starts
    ]


def _build(street: Street) -> list[Quad]:
    for bay in bays(-_BEHIND_M, _END_M):
        street.ground(bay, materials.STREET)
        street.patch(bay[0])
    for side in (-1.0, 1.0):
        street.roadside((-25.0, _END_M - 20.0), side)
    for s_m in np.arange(25.0, _END_M, 40.0):
        street.car(float(s_m + street.rng.uniform(0.0, 20.0)), -LANE_M)
    return street.quads
