"""A clear or cloudy sky as a panorama of radiance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig.drivers.scenes.textures import noise

_HEIGHT, _WIDTH = 256, 512


def cloudy_sky(rng: np.random.Generator, zenith_cd_m2: float, cloud: float) -> NDArray[np.float32]:
    """Return a panorama, 3 x H x W (red, green, blue filter), cd/m2, without the sun's disc.

    Row 0 is the zenith, the middle row the horizon; column 0 looks back (-z), the centre ahead.
    The clear sky brightens towards the horizon; `cloud` in 0..1 is the share that is covered.
    Below the horizon lies distant ground.
    """
    elevation = (0.5 - (np.arange(_HEIGHT) + 0.5) / _HEIGHT) * np.pi
    clear = zenith_cd_m2 * (0.8 + 0.9 * np.exp(-np.clip(elevation, 0, 2) * 3.0))[:, None]
    field = noise(rng, _HEIGHT, _WIDTH, 1.35)
    cover = np.clip((field - np.quantile(field, 1 - cloud)) * 3.5, 0, 1)
    above = clear * (1 + 1.6 * cover)
    blue = np.array([0.72, 1.0, 1.35])[:, None, None]
    colour = blue * (1 - cover) + cover
    ground = np.full_like(above, 0.35 * zenith_cd_m2)
    dome = np.where(elevation[:, None] > 0, above * colour, ground)
    return np.ascontiguousarray(dome, np.float32)


def mean_radiance_cd_m2(sky: NDArray[np.float32]) -> float:
    """Return the cosine-weighted mean radiance of the upper half, as a Bayer pixel sees it."""
    upper = sky[:, : _HEIGHT // 2].astype(np.float64)
    elevation = (0.5 - (np.arange(_HEIGHT // 2) + 0.5) / _HEIGHT) * np.pi
    weight = np.sin(elevation) * np.cos(elevation)
    rows = np.tensordot([0.25, 0.5, 0.25], upper, 1).mean(1)
    return float((rows * weight).sum() / weight.sum())
