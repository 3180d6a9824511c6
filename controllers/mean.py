"""The classical control: bring the mean intensity to a share of full scale, in one step."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rig.core.types import THESIS_LIMITS, Command, Diagnostics, Frame, Limits, Settings
from rig.core.units import gain_db, gain_factor

FULL_SCALE_DN = 255.0
STEEPEST = 8.0
"""No step is larger than this factor: a black or white picture tells only the direction."""
DEAD_BAND = 0.02
"""A mean this near to the target, as a share of it, is left alone: 8-bit rounding is no light."""


@dataclass(slots=True)
class MeanController:
    """Scales exposure x gain by target / mean, exposure first, gain above the cap.

    `percent` of full scale is the mean to aim for, in (0, 100]: 30, 50 and 70 are the classical
    rivals of BorealHDR (2024). `speed` in (0, 1] is the share of a correction, in log brightness,
    that is taken at once. `exposure_us_max` caps the exposure against motion blur; gain makes up
    for it. Raises ValueError when one is out of range.
    """

    percent: float = 50.0
    speed: float = 1.0
    exposure_us_max: float = THESIS_LIMITS.exposure_us[1]
    _limits: Limits = field(init=False, default=THESIS_LIMITS)
    _mean_dn: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        if not 0 < self.percent <= 100:
            raise ValueError(f"percent must be above 0 and at most 100, got {self.percent!r}")
        if not 0 < self.speed <= 1:
            raise ValueError(f"speed must be above 0 and at most 1, got {self.speed!r}")
        if not self.exposure_us_max > 0:
            raise ValueError(f"exposure_us_max must be > 0, got {self.exposure_us_max!r}")

    def reset(self, limits: Limits) -> Command:
        """Begin at 1 ms without gain, or as near to it as the camera can."""
        self._limits = limits
        return Settings(1_000.0, 0.0).clamp(limits)

    def step(self, frame: Frame) -> Command:
        """Return settings whose picture of the same scene has the mean aimed for."""
        self._mean_dn = float(frame.image.mean())
        target_dn = self.percent / 100 * FULL_SCALE_DN
        if abs(self._mean_dn - target_dn) <= DEAD_BAND * target_dn:
            return frame.used.clamp(self._limits)
        ratio = np.clip(target_dn / max(self._mean_dn, 1.0), 1 / STEEPEST, STEEPEST)
        brightness_us = frame.used.exposure_us * gain_factor(frame.used.gain_db)
        return self._split(brightness_us * float(ratio) ** self.speed)

    def diagnostics(self) -> Diagnostics:
        """Return the mean that the last step saw."""
        return {"mean_dn": self._mean_dn}

    def _split(self, brightness_us: float) -> Settings:
        """Return the settings of a brightness (exposure x gain factor): gain only above the cap."""
        shortest_us, longest_us = self._limits.exposure_us
        cap_us = max(min(self.exposure_us_max, longest_us), shortest_us)
        least_gain = gain_factor(self._limits.gain_db[0])
        exposure_us = min(max(brightness_us / least_gain, shortest_us), cap_us)
        gain = max(brightness_us / exposure_us, 1.0)
        return Settings(exposure_us, gain_db(gain)).clamp(self._limits)
