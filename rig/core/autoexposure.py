"""The one automatic exposure and gain law, inside the simulated camera and in software.

It keeps the rules that a recorded trace of a FLIR Blackfly S shows (198 frames): exposure climbs to
its limit before gain rises, gain falls before exposure does, and no frame changes either by more
than a bounded step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from rig.core.types import Limits, Settings
from rig.core.units import gain_db, gain_factor

EXPOSURE_RATIO = (0.885, 1.421)
"""The smallest and largest change of exposure from one frame to the next."""

GAIN_STEP_DB = 1.2
"""The largest change of gain from one frame to the next."""

DEAD_BAND = 0.03
"""The relative error of the mean, in either direction, that is left alone."""


@dataclass(frozen=True, slots=True)
class AutoExposure:
    """The state of the law after some frames: `settings` are those for the next frame.

    `target_dn` is the mean grey to aim for, in (0, 255]; `damping` in [0, 1) is the share of each
    correction that is held back. `settings` are clamped to `limits`. Raises ValueError when
    `target_dn` or `damping` is out of range.
    """

    limits: Limits
    target_dn: float
    damping: float
    settings: Settings

    def __post_init__(self) -> None:
        if not 0 < self.target_dn <= 255:
            raise ValueError(f"target_dn must be in (0, 255], got {self.target_dn!r}")
        if not 0 <= self.damping < 1:
            raise ValueError(f"damping must be in [0, 1), got {self.damping!r}")
        object.__setattr__(self, "settings", self.settings.clamp(self.limits))

    def after(self, mean_dn: float) -> AutoExposure:
        """Return the state after a frame of mean grey `mean_dn`, 0..255, taken with `settings`.

        Raises ValueError when `mean_dn` is not in 0..255.
        """
        if not 0 <= mean_dn <= 255:
            raise ValueError(f"mean_dn must be in 0..255, got {mean_dn!r}")
        error = self.target_dn / max(mean_dn, 1.0)
        settled = 1 / (1 + DEAD_BAND) <= error <= 1 + DEAD_BAND
        if settled and self._on_program():
            return self
        correction = 1.0 if settled else error ** (1 - self.damping)
        slowest, fastest = EXPOSURE_RATIO
        wanted = self._program(min(max(correction, slowest), fastest))
        return replace(self, settings=self._limit_step(wanted))

    def _on_program(self) -> bool:
        """Return whether gain is at its floor or exposure at its ceiling."""
        return (
            self.settings.gain_db == self.limits.gain_db[0]
            or self.settings.exposure_us == self.limits.exposure_us[1]
        )

    def _program(self, correction: float) -> Settings:
        """Return the settings of `correction` times the brightness with the least gain."""
        brightness = self.settings.exposure_us * gain_factor(self.settings.gain_db) * correction
        shortest_us, longest_us = self.limits.exposure_us
        floor_db = self.limits.gain_db[0]
        exposure_us = min(max(brightness / gain_factor(floor_db), shortest_us), longest_us)
        gain = max(gain_db(brightness / exposure_us), floor_db)
        return Settings(exposure_us, gain if exposure_us == longest_us else floor_db)

    def _limit_step(self, wanted: Settings) -> Settings:
        """Return `wanted`, no farther from the present settings than one frame may go."""
        now = self.settings
        slowest, fastest = EXPOSURE_RATIO
        exposure_us = min(
            max(wanted.exposure_us, now.exposure_us * slowest), now.exposure_us * fastest
        )
        gain = min(max(wanted.gain_db, now.gain_db - GAIN_STEP_DB), now.gain_db + GAIN_STEP_DB)
        return Settings(exposure_us, max(gain, 0.0)).clamp(self.limits)
