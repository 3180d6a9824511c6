"""An EMVA 1288 camera sensor: scene radiance in, noisy digital picture out.

Photons and dark electrons arrive as a Poisson process, the full well cuts them off, the read
noise joins, the gain multiplies, the black level is added, the converter rounds, and the response
curve makes 8 bits of it. All of that happens in one pass over the picture.
"""

from __future__ import annotations

import math
from functools import cache
from statistics import NormalDist
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from rig.config import (
    CameraModel,
    GammaResponse,
    LinearResponse,
    Response,
    SrgbResponse,
)
from rig.core.types import Settings
from rig.core.units import US_PER_S, gain_factor

NORMAL_LEVELS = 1 << 16
LEAST_SKEW_CORRECTED_E = 12.0
"""Below this mean, Poisson counts are drawn exactly; above it the Cornish-Fisher expansion of the
Poisson quantile is right to a few thousandths of an electron."""


class Sensor:
    """One physical sensor: its own fixed pattern, and fresh noise for every frame."""

    def __init__(self, model: CameraModel, shape: tuple[int, int], seed: int) -> None:
        """Make the sensor `seed` (which piece of silicon) with `shape` = (height, width) pixels.

        A pixel of a small picture is as large, and as noisy, as one of the full picture.
        """
        self._model = model
        rng = np.random.default_rng(seed)
        unit = rng.standard_normal(shape, dtype=np.float32)
        self._sensitivity = 1 + np.float32(model.pixel.prnu) * unit
        unit = rng.standard_normal(shape, dtype=np.float32)
        self._offset_e = np.float32(model.pixel.dsnu_e) * unit
        levels = (1 << model.converter.bits) - 1
        self._raw = np.arange(levels + 1, dtype=np.uint16)
        self._eight_bit = response_table(model.response, levels + 1)
        self._normal = _normal_quantiles()

    @property
    def electrons_per_cd_m2_s(self) -> float:
        """Return the mean photo-electrons per second of a pixel that looks at 1 cd/m2.

        The illuminance behind a lens is pi/4 * transmission / f_number^2 times the luminance.
        """
        lens, pixel = self._model.lens, self._model.pixel
        illuminance_lx = math.pi / 4 * lens.transmission / lens.f_number**2
        photons = illuminance_lx * pixel.photons_per_lx_um2_s * self._model.picture.pixel_um**2
        return photons * pixel.quantum_efficiency

    def develop(
        self, radiance_cd_m2: NDArray[np.float32], settings: Settings, noise_seed: int
    ) -> NDArray[np.uint8]:
        """Return the 8-bit picture of `radiance_cd_m2` (float32, H x W, >= 0), response applied."""
        return self._expose(radiance_cd_m2, settings, noise_seed, self._eight_bit)

    def digitise(
        self, radiance_cd_m2: NDArray[np.float32], settings: Settings, noise_seed: int
    ) -> NDArray[np.uint16]:
        """Return what the converter measured (uint16, H x W), before the response curve."""
        return self._expose(radiance_cd_m2, settings, noise_seed, self._raw)

    def _expose(
        self,
        radiance_cd_m2: NDArray[np.float32],
        settings: Settings,
        noise_seed: int,
        table: NDArray[Any],
    ) -> NDArray[Any]:
        if radiance_cd_m2.shape != self._sensitivity.shape:
            raise ValueError(
                f"radiance is {radiance_cd_m2.shape}, the sensor {self._sensitivity.shape}"
            )
        pixel, converter = self._model.pixel, self._model.converter
        exposure_s = settings.exposure_us / US_PER_S
        picture = np.empty(radiance_cd_m2.shape, table.dtype)
        _expose(
            np.ascontiguousarray(radiance_cd_m2, np.float32),
            self._sensitivity,
            self._offset_e,
            np.float32(self.electrons_per_cd_m2_s * exposure_s),
            np.float32(pixel.dark_current_e_per_s * exposure_s),
            np.float32(pixel.full_well_e),
            np.float32(pixel.read_noise_e),
            np.float32(gain_factor(settings.gain_db) / converter.e_per_dn),
            np.float32(converter.black_level_dn),
            np.uint64(noise_seed & 0xFFFFFFFFFFFFFFFF),
            self._normal,
            table,
            picture,
        )
        return picture


def response_table(response: Response, levels: int) -> NDArray[np.uint8]:
    """Return the 8-bit value of each of the `levels` that the converter can give."""
    light = np.linspace(0.0, 1.0, levels)
    if isinstance(response, LinearResponse):
        curve = light
    elif isinstance(response, GammaResponse):
        curve = light ** (1 / response.gamma)
    elif isinstance(response, SrgbResponse):
        curve = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    else:
        curve = np.interp(light, np.linspace(0.0, 1.0, len(response.table)), response.table)
    return np.rint(255 * curve).astype(np.uint8)


@cache
def _normal_quantiles() -> NDArray[np.float32]:
    """Return the standard normal at the middles of NORMAL_LEVELS equal shares, variance 1."""
    quantile = NormalDist().inv_cdf
    shares = (np.arange(NORMAL_LEVELS // 2) + 0.5) / NORMAL_LEVELS
    below = np.array([quantile(share) for share in shares])
    z = np.concatenate((below, -below[::-1]))
    return np.asarray(z / z.std(), np.float32)


@nb.njit(inline="always")
def _row_key(noise_seed: np.uint64, row: int) -> np.uint64:
    """Return 64 well-stirred bits for one row of one frame (splitmix64)."""
    key = noise_seed + np.uint64(row + 1) * np.uint64(0x9E3779B97F4A7C15)
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return key ^ (key >> np.uint64(31))


@nb.njit(inline="always")
def _random_bits(column: int, low: np.uint32, high: np.uint32) -> np.uint32:
    """Return the 32 random bits of a pixel: a hash of its column under both halves of its key."""
    x = np.uint32(np.uint32(column) ^ low)
    x = np.uint32(np.uint32(x ^ (x >> np.uint32(16))) * np.uint32(0x7FEB352D))
    x = np.uint32(np.uint32(x ^ (x >> np.uint32(15))) + high)
    x = np.uint32(np.uint32(x ^ (x >> np.uint32(16))) * np.uint32(0x846CA68B))
    return np.uint32(x ^ (x >> np.uint32(16)))


@nb.njit(inline="always")
def _large_count_e(mean_e: np.float32, z: np.float32) -> np.float32:
    """Return the Poisson quantile of normal quantile `z` (Cornish-Fisher, on whole numbers)."""
    deviation_e = np.float32(math.sqrt(mean_e))
    skew = (z * z + np.float32(2)) * np.float32(1 / 6)
    tail = (z * z + np.float32(2)) * z * np.float32(1 / 72) / deviation_e
    return np.float32(math.floor(mean_e + deviation_e * z + skew - tail))


@nb.njit(inline="always")
def _small_count_e(mean_e: np.float32, bits: np.uint32) -> np.float32:
    """Return a Poisson count by inversion of a uniform number made of 32 `bits`."""
    left = (float(bits) + 0.5) / 4294967296.0
    probability = math.exp(-float(mean_e))
    count = 0
    while left > probability and count < 100:
        left -= probability
        count += 1
        probability *= float(mean_e) / count
    return np.float32(count)


@nb.njit(parallel=True, cache=True)
def _expose(  # type: ignore[no-untyped-def]
    radiance,
    sensitivity,
    offset_e,
    e_per_radiance,
    dark_e,
    full_well_e,
    read_noise_e,
    dn_per_e,
    black_level_dn,
    noise_seed,
    normal,
    table,
    picture,
):
    """Fill `picture`; every pixel's noise depends on seed, row and column alone."""
    height, width = radiance.shape
    top = np.float32(table.size - 1)
    enough_e = np.float32(4) * full_well_e
    for row in nb.prange(height):
        key = _row_key(noise_seed, row)
        low, high = np.uint32(key), np.uint32(key >> np.uint64(32))
        photo_e = np.empty(width, np.float32)
        bits = np.empty(width, np.uint32)
        few = False
        for column in range(width):
            mean_e = radiance[row, column] * e_per_radiance * sensitivity[row, column] + dark_e
            mean_e = min(max(mean_e, np.float32(1e-6)), enough_e)
            bits[column] = _random_bits(column, low, high)
            z = normal[bits[column] & np.uint32(0xFFFF)]
            few |= mean_e < LEAST_SKEW_CORRECTED_E
            photo_e[column] = _large_count_e(mean_e, z)
        if few:
            for column in range(width):
                mean_e = radiance[row, column] * e_per_radiance * sensitivity[row, column] + dark_e
                if mean_e < LEAST_SKEW_CORRECTED_E:
                    fresh = _random_bits(column, high, low)
                    photo_e[column] = _small_count_e(max(mean_e, np.float32(0)), fresh)
        for column in range(width):
            collected_e = min(photo_e[column] + offset_e[row, column], full_well_e)
            z = normal[bits[column] >> np.uint32(16)]
            dn = (collected_e + read_noise_e * z) * dn_per_e + black_level_dn + np.float32(0.5)
            picture[row, column] = table[int(min(max(dn, np.float32(0)), top))]
