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

NORMAL_BITS = 12
NORMAL_LEVELS = 1 << NORMAL_BITS
"""Equal shares of the normal distribution; their table fits the processor's nearest cache."""
PATTERN_STEPS = 32
"""Steps of the fixed pattern per standard deviation."""

FEW_E = 4.0
"""Mean counts below this are drawn from the exact Poisson distribution."""

FEW_STEPS = 128
"""Tabulated means per electron; a mean in between is a mixture of its two neighbours."""

COUNTS = 32
"""Counts of the small means: more than these happen once in 10^18."""

Row = NDArray[np.float32]
Bits = NDArray[np.uint32]


class Sensor:
    """One physical sensor: its own fixed pattern, and fresh noise for every frame."""

    def __init__(self, model: CameraModel, shape: tuple[int, int], seed: int) -> None:
        """Make the sensor `seed` (which piece of silicon) with `shape` = (height, width) pixels.

        A pixel of a small picture is as large, and as noisy, as one of the full picture.
        """
        self._model = model
        rng = np.random.default_rng(seed)
        self._sensitivity = _fixed_pattern(rng, shape)
        self._offset = _fixed_pattern(rng, shape)
        levels = (1 << model.converter.bits) - 1
        self._raw = np.arange(levels + 1, dtype=np.uint16)
        self._eight_bit = response_table(model.response, levels + 1)
        self._normal = _normal_quantiles()
        self._few = _few_photons()

    @property
    def electrons_per_cd_m2_s(self) -> float:
        """Return the mean photo-electrons per second of a pixel that looks at 1 cd/m2."""
        return electrons_per_cd_m2_s(self._model)

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
            self._offset,
            np.float32(pixel.prnu / PATTERN_STEPS),
            np.float32(pixel.dsnu_e / PATTERN_STEPS),
            np.float32(self.electrons_per_cd_m2_s * exposure_s),
            np.float32(pixel.dark_current_e_per_s * exposure_s),
            np.float32(pixel.full_well_e),
            np.float32(pixel.read_noise_e),
            np.float32(gain_factor(settings.gain_db) / converter.e_per_dn),
            np.float32(converter.black_level_dn),
            np.uint64(noise_seed & 0xFFFFFFFFFFFFFFFF),
            self._normal,
            self._few,
            table,
            picture,
        )
        return picture


def electrons_per_cd_m2_s(model: CameraModel) -> float:
    """Return the mean photo-electrons per second of a pixel that looks at 1 cd/m2.

    The illuminance behind a lens is pi/4 * transmission / f_number^2 times the luminance.
    """
    lens, pixel = model.lens, model.pixel
    illuminance_lx = math.pi / 4 * lens.transmission / lens.f_number**2
    photons = illuminance_lx * pixel.photons_per_lx_um2_s * model.picture.pixel_um**2
    return photons * pixel.quantum_efficiency


def response_curve(response: Response, light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the grey value 0..1 of each `light` 0..1."""
    if isinstance(response, LinearResponse):
        return light
    if isinstance(response, GammaResponse):
        return np.asarray(light ** (1 / response.gamma), np.float64)
    if isinstance(response, SrgbResponse):
        return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.interp(light, np.linspace(0.0, 1.0, len(response.table)), response.table)


def response_table(response: Response, levels: int) -> NDArray[np.uint8]:
    """Return the 8-bit value of each of the `levels` that the converter can give."""
    curve = response_curve(response, np.linspace(0.0, 1.0, levels))
    return np.rint(255 * curve).astype(np.uint8)


def _fixed_pattern(rng: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.int8]:
    """Return normal deviates in steps of 1/PATTERN_STEPS: four times less memory to read."""
    deviates = PATTERN_STEPS * rng.standard_normal(shape, dtype=np.float32)
    return np.clip(np.rint(deviates), -127, 127).astype(np.int8)


@cache
def _normal_quantiles() -> NDArray[np.float32]:
    """Return the standard normal at the middles of NORMAL_LEVELS equal shares, variance 1."""
    quantile = NormalDist().inv_cdf
    shares = (np.arange(NORMAL_LEVELS // 2) + 0.5) / NORMAL_LEVELS
    below = np.array([quantile(share) for share in shares])
    z = np.concatenate((below, -below[::-1]))
    return np.asarray(z / z.std(), np.float32)


@cache
def _few_photons() -> NDArray[np.uint32]:
    """Return alias tables of the Poisson distribution for the means k / FEW_STEPS up to FEW_E.

    A row has COUNTS columns; a column is drawn evenly. Its upper 27 bits are the share at which the
    column's own count holds, the lower 5 bits are the count that holds otherwise (Walker, Vose).
    """
    means = np.arange(int(FEW_E * FEW_STEPS) + 2) / FEW_STEPS
    counts = np.arange(COUNTS)
    factorial = np.array([math.factorial(k) for k in range(COUNTS)], float)
    return np.concatenate(
        [_alias_row(mean**counts * math.exp(-mean) / factorial) for mean in means]
    )


def _alias_row(probability: NDArray[np.float64]) -> NDArray[np.uint32]:
    share = probability / probability.sum() * COUNTS
    alias = np.arange(COUNTS)
    small = [k for k in range(COUNTS) if share[k] < 1]
    large = [k for k in range(COUNTS) if share[k] >= 1]
    while small and large:
        poor, rich = small.pop(), large[-1]
        alias[poor] = rich
        share[rich] -= 1 - share[poor]
        if share[rich] < 1:
            small.append(large.pop())
    share[small + large] = 1
    threshold = np.minimum(np.rint(share * (1 << 27)), (1 << 27) - 1).astype(np.uint32)
    return np.asarray(threshold << np.uint32(5) | alias.astype(np.uint32), np.uint32)


@nb.njit(inline="always", error_model="numpy")
def _row_key(noise_seed: np.uint64, row: int) -> np.uint64:
    """Return 64 well-stirred bits for one row of one frame (splitmix64)."""
    key = noise_seed + np.uint64(row + 1) * np.uint64(0x9E3779B97F4A7C15)
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return key ^ (key >> np.uint64(31))


@nb.njit(inline="always", error_model="numpy")
def _random_bits(column: int, low: np.uint32, high: np.uint32) -> np.uint32:
    """Return the 32 random bits of a pixel: a hash of its column under both halves of its key."""
    x = np.uint32(np.uint32(column) ^ low)
    x = np.uint32(np.uint32(x ^ (x >> np.uint32(16))) * np.uint32(0x7FEB352D))
    x = np.uint32(np.uint32(x ^ (x >> np.uint32(15))) + high)
    x = np.uint32(np.uint32(x ^ (x >> np.uint32(16))) * np.uint32(0x846CA68B))
    return np.uint32(x ^ (x >> np.uint32(16)))


@nb.njit(error_model="numpy")
def _count_photons(mean_e: Row, z: Row, count_e: Row) -> None:
    """Draw Poisson counts by the Cornish-Fisher quantile on whole numbers, for large means.

    The third-order expansion with the lattice correction; at a mean of FEW_E its distribution
    function is right to 0.0011, its mean and variance to 0.0004.
    """
    for column in range(mean_e.size):
        mean = mean_e[column] if mean_e[column] > np.float32(FEW_E) else np.float32(FEW_E)
        normal = z[column]
        deviation = np.sqrt(mean)
        curve = normal * normal + np.float32(2)
        skew = curve * np.float32(1 / 6)
        tail = curve * normal * np.float32(1 / 72) / deviation
        count = np.floor(mean + deviation * normal + skew - tail)
        count_e[column] = count if count > np.float32(0) else np.float32(0)


@nb.njit(error_model="numpy")
def _count_few_photons(mean_e: Row, dither: Bits, bits: Bits, few: Bits, count_e: Row) -> None:
    """Redraw, from the exact distribution, the counts whose mean is below FEW_E.

    16 bits of `dither` choose between the two tabulated means next to the true one, so that the
    mean is right; `bits` draws from the alias table. Larger means keep their count.
    """
    width = mean_e.size
    place = np.empty(width, np.uint32)
    entry = np.empty(width, np.uint32)
    for column in range(width):
        mean = mean_e[column] if mean_e[column] < np.float32(FEW_E) else np.float32(FEW_E)
        share = np.float32(np.int32(dither[column] & np.uint32(0xFFFF))) * np.float32(2.0**-16)
        step = np.int32(mean * np.float32(FEW_STEPS) + share)
        own = np.int32(bits[column] >> np.uint32(27))
        place[column] = np.uint32(step * np.int32(COUNTS) + own)
    for column in range(width):
        entry[column] = few[place[column]]
    for column in range(width):
        own = np.int32(bits[column] >> np.uint32(27))
        other = np.int32(entry[column] & np.uint32(31))
        holds = np.int32(bits[column] & np.uint32(0x7FFFFFF)) < np.int32(
            entry[column] >> np.uint32(5)
        )
        count = np.float32(own if holds else other)
        count_e[column] = count if mean_e[column] < np.float32(FEW_E) else count_e[column]


@nb.njit(parallel=True, cache=True, error_model="numpy")
def _expose(  # type: ignore[no-untyped-def]
    radiance,
    sensitivity,
    offset,
    prnu_step,
    dsnu_step_e,
    e_per_radiance,
    dark_e,
    full_well_e,
    read_noise_e,
    dn_per_e,
    black_level_dn,
    noise_seed,
    normal,
    few_photons,
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
        few = np.int32(0)
        mean_e = np.empty(width, np.float32)
        bits = np.empty(width, np.uint32)
        for column in range(width):
            response = np.float32(1) + prnu_step * np.float32(sensitivity[row, column])
            mean = radiance[row, column] * e_per_radiance * response + dark_e
            mean = mean if mean > np.float32(0) else np.float32(0)
            mean_e[column] = mean if mean < enough_e else enough_e
            few += np.int32(mean < np.float32(FEW_E))
            bits[column] = _random_bits(column, low, high)
        shot_z = np.empty(width, np.float32)
        read_z = np.empty(width, np.float32)
        for column in range(width):
            shot_z[column] = normal[bits[column] & np.uint32(NORMAL_LEVELS - 1)]
            read_z[column] = normal[bits[column] >> np.uint32(32 - NORMAL_BITS)]
        count_e = np.empty(width, np.float32)
        _count_photons(mean_e, shot_z, count_e)
        if few > 0:
            more_bits = np.empty(width, np.uint32)
            for column in range(width):
                more_bits[column] = _random_bits(column, high, low)
            _count_few_photons(mean_e, bits, more_bits, few_photons, count_e)
        level = np.empty(width, np.int32)
        for column in range(width):
            collected_e = count_e[column] + dsnu_step_e * np.float32(offset[row, column])
            collected_e = collected_e if collected_e < full_well_e else full_well_e
            dn = (collected_e + read_noise_e * read_z[column]) * dn_per_e + black_level_dn
            dn += np.float32(0.5)
            dn = dn if dn > np.float32(0) else np.float32(0)
            level[column] = np.int32(dn if dn < top else top)
        for column in range(width):
            picture[row, column] = table[np.uint32(level[column])]
