"""Exposure by the ascent of a soft percentile of the gradient (Zhang et al. 2017; thesis eq. 3.6).

As in the authors' code: the rate of the ascent follows the scene's irradiance and the derivatives
of over-exposed pixels count against exposure; outside a band of mean intensity the mean is steered
instead; no step is larger than a tenth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rig.controllers.split import GAINS, check_cap, scaled
from rig.core.types import THESIS_LIMITS, Command, Diagnostics, Frame, Limits, Settings
from rig.core.units import gain_factor
from rig.vision.metrics import mean_dn, sample
from rig.vision.metrics.zhang import ORDER, scharr, sine_weights

IRRADIANCE_PER_US = (6e-5, 8.3e-5, 1.1e-4, 2.4e-4, 1e-3, 2.66e-3, 8e-3)
RATES = (2.5, 2.0, 1.3, 0.3, 0.002, 0.0008, 0.0003)
"""The authors' rates of ascent, at shares of full scale that arrive in a microsecond."""
IRRADIANCE_PERCENTILE = 60
GAIN_SLOPE, GAIN_RATE_MIN = 0.2, 0.1
"""The rate falls by a fifth for every 1 that is added to the gain factor; never below a tenth."""

OVER_DN, OVER_FACTOR, OVER_LEAST = 252, -3.0, 0.5
"""A derivative from this grey on counts as -3 times its size, which is at least 0.5."""

MEAN_BAND_DN = (70.0, 190.0)
OVER_SHARE, OVER_SHARE_DN = 0.5, 251
MIDDLE_DN = 127.0
STEP_MAX = 0.1
STEP_MIN = 0.005
"""A smaller relative step is not made: the simulated and the real camera round."""

GAIN_STEP_DB = 1.0
GAIN_UP_US, GAIN_DOWN_US = 10_000.0, 2_000.0
"""From this exposure on gain takes over a step; below that one it gives one back."""

TILES_ACROSS = 26
MODES = ("heuristic", *GAINS)


@dataclass(slots=True)
class ZhangController:
    """Climbs the soft percentile `pivot` of the gradient by its derivative with exposure.

    `rate` multiplies the authors' rates. `gain` heuristic moves gain by 1 dB where exposure passes
    10 ms or 2 ms, fixed keeps `gain_db`, split lets exposure go up to `exposure_us_max` and gain
    take the rest. Raises ValueError for an option out of range.
    """

    pivot: float = 0.7
    rate: float = 30.0
    gain: str = "heuristic"
    gain_db: float = 0.0
    exposure_us_max: float = 4_000.0
    _limits: Limits = field(init=False, default=THESIS_LIMITS)
    _derivative: float = field(init=False, default=0.0)
    _mean_dn: float = field(init=False, default=0.0)
    _phase: str = field(init=False, default="")
    _caution: float = field(init=False, default=1.0)

    def __post_init__(self) -> None:
        if not 0 < self.pivot < 1:
            raise ValueError(f"pivot must be between 0 and 1, got {self.pivot!r}")
        if not 0 < self.rate < math.inf:
            raise ValueError(f"rate must be > 0, got {self.rate!r}")
        if self.gain not in MODES:
            raise ValueError(f"gain must be {', '.join(MODES)}, got {self.gain!r}")
        check_cap(self.exposure_us_max)
        Settings(1.0, self.gain_db)

    def reset(self, limits: Limits) -> Command:
        """Begin at 1 ms and the fixed gain, or as near to it as the camera can."""
        self._limits = limits
        self._derivative, self._mean_dn, self._phase, self._caution = 0.0, 0.0, "", 1.0
        return Settings(1_000.0, self.gain_db).clamp(limits)

    def step(self, frame: Frame) -> Command:
        """Return the next exposure, and the gain that its place asks for."""
        part = sample(frame.image, frame.pixel_format, TILES_ACROSS)
        grey = part.grey()
        seen = part.judged(grey)
        self._mean_dn = mean_dn(frame.image)
        over = float(np.count_nonzero(seen >= OVER_SHARE_DN)) / seen.size
        if not MEAN_BAND_DN[0] <= self._mean_dn <= MEAN_BAND_DN[1] or over > OVER_SHARE:
            self._phase, self._caution = "mean", 1.0
            change = MIDDLE_DN / max(self._mean_dn, 1.0) - 1
        else:
            self._phase = "ascent"
            change = self._ascent(frame.used, grey, seen, part.places)
            lowest_dn, highest_dn = MEAN_BAND_DN
            least, most = lowest_dn / self._mean_dn - 1, highest_dn / self._mean_dn - 1
            change = min(max(change, least), most)  # else both rules would take turns for ever
        change = min(max(change, -STEP_MAX), STEP_MAX)
        if abs(change) < STEP_MIN:
            self._phase = "hold"
            return frame.used.clamp(self._limits)
        return self._move(frame.used, 1 + change)

    def diagnostics(self) -> Diagnostics:
        """Return the phase (ascent, mean or hold), the derivative and the mean."""
        if not self._phase:
            return {}
        return {
            "phase": self._phase,
            "derivative_per_ms": self._derivative,
            "mean_dn": self._mean_dn,
        }

    def _ascent(
        self,
        used: Settings,
        grey: NDArray[np.uint8],
        seen: NDArray[np.uint8],
        places: tuple[NDArray[np.int64], NDArray[np.int64]],
    ) -> float:
        """Return the relative change of exposure that the derivative asks for."""
        across, down = scharr(grey)
        squared = (across * across + down * down)[np.ix_(*places)].ravel()
        slopes = 2 * squared / (used.exposure_us / 1e3)
        over = seen.ravel() >= OVER_DN
        slopes[over] = OVER_FACTOR * np.maximum(slopes[over], OVER_LEAST)
        weights = sine_weights(squared.size, self.pivot, ORDER)
        derivative = float(slopes[np.argsort(squared, kind="stable")] @ weights)
        turned = derivative * self._derivative < 0
        self._caution = self._caution / 2 if turned else min(self._caution * 1.2, 1.0)
        self._derivative = derivative
        irradiance = float(np.percentile(seen, IRRADIANCE_PERCENTILE)) / 255 / used.exposure_us
        rate = ascent_rate(irradiance) * gain_share(used.gain_db)
        wanted = self.rate * rate * derivative / used.exposure_us
        return self._caution * min(max(wanted, -STEP_MAX), STEP_MAX)

    def _move(self, used: Settings, factor: float) -> Settings:
        if self.gain != "heuristic":
            return scaled(used, factor, self._limits, self.gain, self.exposure_us_max)
        exposure_us, gain_db = used.exposure_us * factor, used.gain_db
        lowest_db, highest_db = self._limits.gain_db
        step_db = 0.0
        if exposure_us > min(GAIN_UP_US, self.exposure_us_max):
            step_db = min(GAIN_STEP_DB, highest_db - gain_db)
        elif exposure_us < GAIN_DOWN_US:
            step_db = -min(GAIN_STEP_DB, gain_db - lowest_db)
        exposure_us = min(exposure_us / gain_factor(step_db), self.exposure_us_max)
        return Settings(exposure_us, max(gain_db + step_db, 0.0)).clamp(self._limits)


def ascent_rate(irradiance_per_us: float) -> float:
    """Return the authors' rate: their table, logarithmic below it and exponential above."""
    least, most = IRRADIANCE_PER_US[0], IRRADIANCE_PER_US[-1]
    if irradiance_per_us <= least:
        return RATES[0] + math.log10(least / max(irradiance_per_us, 1e-12))
    if irradiance_per_us >= most:
        return float(RATES[-1] * 10 ** (most - irradiance_per_us))
    return float(np.interp(irradiance_per_us, IRRADIANCE_PER_US, RATES))


def gain_share(gain_db: float) -> float:
    """Return by how much gain slows the ascent, 0.1..1."""
    return max(1 - GAIN_SLOPE * (gain_factor(gain_db) - 1), GAIN_RATE_MIN)
