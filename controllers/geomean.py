"""Geometric-mean metering with a speed and a shutter cap."""

from __future__ import annotations

from dataclasses import dataclass, field

from rig.controllers.mean import FULL_SCALE_DN, correction
from rig.controllers.split import brightness_us, check_cap, split
from rig.core.types import THESIS_LIMITS, Command, Diagnostics, Frame, Limits, Settings
from rig.vision.metrics import geometric_mean_dn, sample


@dataclass(slots=True)
class GeomeanController:
    """Scales exposure x gain by target / geometric mean, exposure first, gain above the cap.

    The geometric mean weighs dark parts more than the mean does, so a small bright exit does not
    blind it. `target` in (0, 1] is a share of full scale; `speed` in (0, 1] the share of a
    correction, in log brightness, that is taken at once; `exposure_us_max` caps the exposure.
    Raises ValueError when one is out of range.
    """

    target: float = 0.5
    speed: float = 0.9
    exposure_us_max: float = 700.0
    _limits: Limits = field(init=False, default=THESIS_LIMITS)
    _metered_dn: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        if not 0 < self.target <= 1:
            raise ValueError(f"target must be above 0 and at most 1, got {self.target!r}")
        if not 0 < self.speed <= 1:
            raise ValueError(f"speed must be above 0 and at most 1, got {self.speed!r}")
        check_cap(self.exposure_us_max)

    def reset(self, limits: Limits) -> Command:
        """Begin at 1 ms without gain, or as near to it as the camera can."""
        self._limits = limits
        return Settings(1_000.0, 0.0).clamp(limits)

    def step(self, frame: Frame) -> Command:
        """Return settings whose picture of the same scene has the geometric mean aimed for."""
        self._metered_dn = geometric_mean_dn(sample(frame.image, frame.pixel_format).mosaic)
        factor = correction(self._metered_dn, self.target * FULL_SCALE_DN)
        if factor == 1:
            return frame.used.clamp(self._limits)
        wanted_us = brightness_us(frame.used) * factor**self.speed
        return split(wanted_us, self._limits, self.exposure_us_max)

    def diagnostics(self) -> Diagnostics:
        """Return the geometric mean that the last step saw."""
        return {"geometric_mean_dn": self._metered_dn}
