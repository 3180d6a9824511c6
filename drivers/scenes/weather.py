"""The light of a day, drawn from a seed: sun, sky and clouds."""

from __future__ import annotations

import math
import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.drivers.scenes.light import Sunlight
from rig.drivers.scenes.sky import cloudy_sky, mean_radiance_cd_m2


class Weather(NamedTuple):
    """A sun that shines from an azimuth (from z towards x), and a partly covered sky."""

    sun_azimuth_rad: float
    sun_elevation_rad: float
    sun_lux: float
    sky_cd_m2: float
    cloud: float

    def veiled(self, share: float) -> Weather:
        """Return the sun and sky when haze lets only `share` (0..1) of them through."""
        return self._replace(sun_lux=share * self.sun_lux, sky_cd_m2=share * self.sky_cd_m2)


class Daylight(NamedTuple):
    """The panorama that is seen and the light that falls on surfaces."""

    sky: NDArray[np.float32]
    sun: Sunlight


def world_rng(name: str, split: str, seed: int, part: str) -> np.random.Generator:
    """Return the random numbers of one part of one world; no two worlds share any."""
    words = [zlib.crc32(text.encode()) for text in (name, split, part)]
    return np.random.default_rng([*words, seed])


def draw_weather(rng: np.random.Generator, azimuth_rad: float, spread_deg: float = 40.0) -> Weather:
    """Return a clear or partly cloudy noon, its sun within `spread_deg` of an azimuth.

    The ground gets 77,000 to 83,000 lx, whatever the height of the sun.
    """
    azimuth_rad += math.radians(rng.uniform(-spread_deg, spread_deg))
    elevation_rad = math.radians(rng.uniform(40.0, 55.0))
    sky_cd_m2 = rng.uniform(4500.0, 5500.0)
    from_sun_lux = rng.uniform(7.7e4, 8.3e4) - math.pi * sky_cd_m2
    return Weather(
        sun_azimuth_rad=azimuth_rad,
        sun_elevation_rad=elevation_rad,
        sun_lux=from_sun_lux / math.sin(elevation_rad),
        sky_cd_m2=sky_cd_m2,
        cloud=rng.uniform(0.05, 0.5),
    )


def daylight(weather: Weather, rng: np.random.Generator) -> Daylight:
    """Return the light of one weather; `rng` shapes the clouds."""
    sky = cloudy_sky(rng, weather.sky_cd_m2, weather.cloud)
    rise, level = math.sin(weather.sun_elevation_rad), math.cos(weather.sun_elevation_rad)
    azimuth = weather.sun_azimuth_rad
    towards = np.array([level * math.sin(azimuth), rise, level * math.cos(azimuth)])
    ground = float(sky[1, -1].mean())
    return Daylight(sky, Sunlight(towards, weather.sun_lux, mean_radiance_cd_m2(sky), ground))
