"""The world `wall`: a blank, evenly lit surface before two cameras that stand still."""

from __future__ import annotations

import numpy as np

from rig.drivers.scenes.geometry import Assembly, Material
from rig.drivers.scenes.light import Sunlight
from rig.drivers.scenes.textures import MACRO
from rig.drivers.scenes.trajectories import Drive, Path
from rig.drivers.scenes.world import Plan

WALL_VERSION = "wall/1"

_RADIANCE_CD_M2 = 100.0
_DISTANCE_M = 2.0
_HALF_M = 10.0
_STAND_S = 12.0


def wall(seed: int, split: str, speed_mps: float) -> Plan:
    """Return the plan of a white wall of 100 cd/m2; every seed, split and speed is alike."""
    path = Path((), _DISTANCE_M)
    put = Assembly(np.random.default_rng(0))
    across = (-_HALF_M, _HALF_M)
    put.gate(path, _DISTANCE_M, across, across, Material("white", None))
    dark_sky = np.zeros((3, 4, 4), np.float32)
    light = Sunlight(np.array([0.0, 1.0, 0.0]), 0.0, _RADIANCE_CD_M2, _RADIANCE_CD_M2)
    white = np.ones((4, 4), np.float32)
    return Plan(
        key="wall",
        version=WALL_VERSION,
        quads=put.quads,
        textures=lambda: {MACRO: white, "white": white},
        sky=lambda: dark_sky,
        sun=light,
        drive=Drive(path, 0.0, 0.0, 0.0, 0.0, (), (), (), (), ()),
        drive_s=_STAND_S,
    )
