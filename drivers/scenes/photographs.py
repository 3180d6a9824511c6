"""Photographed ground and skies: textures and panoramas in the public domain."""

from __future__ import annotations

import math
from importlib import resources
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.drivers.scenes.sky import mean_radiance_cd_m2

Image = NDArray[np.float32]

_GAMMA = 2.2
_DISC = 6.0
"""What is brighter than so many times the mean sky belongs to the sun, which shines by itself."""


class Dome(NamedTuple):
    """A panorama, 3 x H x W cd/m2 without the sun's disc, and where the sun stands in it."""

    sky: Image
    sun_azimuth_rad: float
    sun_elevation_rad: float


def ground(name: Literal["grass", "gravel"], albedo: float) -> Image:
    """Return a photographed texture, mirrored so that it tiles, with a mean albedo, 1024 x 1024."""
    picture = _read(f"{name}.jpg", cv2.IMREAD_GRAYSCALE).astype(np.float32) / 255
    linear = picture**_GAMMA
    half = np.concatenate([linear, linear[:, ::-1]], 1)
    whole = np.concatenate([half, half[::-1]], 0)
    return np.asarray(whole * (albedo / whole.mean()), np.float32)


def dome(name: Literal["sunny", "overcast"], sky_cd_m2: float, turn_rad: float) -> Dome:
    """Return a photographed sky, turned to the right about the zenith, with a mean luminance.

    `sky_cd_m2` is the cosine-weighted mean of the upper half. Layout as in `sky.cloudy_sky`.
    """
    bgr = _read(f"{name}.hdr", cv2.IMREAD_UNCHANGED)
    height, width = bgr.shape[:2]
    steps = round(turn_rad / (2 * math.pi) * width)
    sky = np.roll(np.moveaxis(bgr[..., ::-1], 2, 0).astype(np.float32), steps, axis=2)
    brightest = np.unravel_index(int(sky.sum(0).argmax()), (height, width))
    sky = np.minimum(sky, _DISC * mean_radiance_cd_m2(np.minimum(sky, np.percentile(sky, 99))))
    sky *= np.float32(sky_cd_m2 / mean_radiance_cd_m2(sky))
    row, column = (float(v) for v in brightest)
    azimuth = ((column + 0.5) / width - 0.5) * 2 * math.pi
    elevation = (0.5 - (row + 0.5) / height) * math.pi
    return Dome(np.ascontiguousarray(sky), azimuth, elevation)


def _read(file: str, flags: int) -> NDArray[np.generic]:
    data = (resources.files("rig") / "drivers" / "scenes" / "photographs" / file).read_bytes()
    found = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    assert found is not None
    return np.asarray(found)
