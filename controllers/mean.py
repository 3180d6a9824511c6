"""The classical control: bring the mean intensity to a share of full scale, in one step."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rig.controllers.split import brightness_us, check_cap, split
from rig.core.types import THESIS_LIMITS, Command, Diagnostics, Frame, Limits, Settings
from rig.vision.metrics import mean_dn

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
    exposure_us_max: float = 1_000.0
    _limits: Limits = field(init=False, default=THESIS_LIMITS)
    _mean_dn: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        if not 0 < self.percent <= 100:
            raise ValueError(f"percent must be above 0 and at most 100, got {self.percent!r}")
        if not 0 < self.speed <= 1:
            raise ValueError(f"speed must be above 0 and at most 1, got {self.speed!r}")
        check_cap(self.exposure_us_max)

    def reset(self, limits: Limits) -> Command:
        """Begin at 1 ms without gain, or as near to it as the camera can."""
        self._limits = limits
        return Settings(1_000.0, 0.0).clamp(limits)

    def step(self, frame: Frame) -> Command:
        """Return settings whose picture of the same scene has the mean aimed for."""
        self._mean_dn = mean_dn(frame.image)
        target_dn = self.percent / 100 * FULL_SCALE_DN
        factor = correction(self._mean_dn, target_dn)
        if factor == 1:
            return frame.used.clamp(self._limits)
        wanted_us = brightness_us(frame.used) * factor**self.speed
        return split(wanted_us, self._limits, self.exposure_us_max)

    def diagnostics(self) -> Diagnostics:
        """Return the mean that the last step saw."""
        return {"mean_dn": self._mean_dn}


def correction(measured_dn: float, target_dn: float) -> float:
    """Return the factor from what was measured to the target; 1 inside the dead band."""
    if abs(measured_dn - target_dn) <= DEAD_BAND * target_dn:
        return 1.0
    return float(np.clip(target_dn / max(measured_dn, 1.0), 1 / STEEPEST, STEEPEST))
