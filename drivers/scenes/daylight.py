"""The day around a building: a photographed sky, its sun, and how bright both are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.drivers.scenes.light import Sunlight
from rig.drivers.scenes.photographs import dome

_GROUND_ALBEDO = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Daylight:
    """A sky, 3 x H x W cd/m2, and the light of it and the sun; `words` name what was drawn."""

    words: str
    sky: NDArray[np.float32]
    sun: Sunlight


def draw_daylight(rng: np.random.Generator) -> Daylight:
    """Return a sunny day (two of three) or an overcast one, the sun anywhere around.

    Sun 60,000 to 100,000 lx on a surface that faces it; sky 3,500 to 5,500 cd/m2, overcast 2,500 to
    9,000 cd/m2: 8,000 to 28,000 lx on the ground.
    """
    sunny = bool(rng.random() < 2 / 3)
    turn_rad = float(rng.uniform(0.0, 2 * math.pi))
    sky_cd_m2 = float(rng.uniform(3500.0, 5500.0) if sunny else rng.uniform(2500.0, 9000.0))
    sun_lux = float(rng.uniform(6e4, 1e5)) if sunny else 0.0
    found = dome("sunny" if sunny else "overcast", sky_cd_m2, turn_rad)
    rise = math.sin(found.sun_elevation_rad)
    level = math.cos(found.sun_elevation_rad)
    azimuth = found.sun_azimuth_rad
    towards = np.array([level * math.sin(azimuth), rise, level * math.cos(azimuth)])
    ground = _GROUND_ALBEDO * (sky_cd_m2 + sun_lux * rise / math.pi)
    words = f"{sunny} {turn_rad:.6f} {sky_cd_m2:.3f} {sun_lux:.3f}"
    return Daylight(words, found.sky, Sunlight(towards, sun_lux, sky_cd_m2, ground))
