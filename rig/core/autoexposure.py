"""The one automatic exposure and gain law, inside the simulated camera and in software.

It keeps the rules that a recorded trace of a FLIR Blackfly S shows (198 frames): exposure climbs to
its limit before gain rises, gain falls before exposure does, and no frame changes either by more
than a bounded step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.core.types import Auto, Limits, Metering, Priority, Settings
from rig.core.units import gain_db, gain_factor

EXPOSURE_RATIO = (0.885, 1.421)
"""The smallest and largest change of exposure from one frame to the next."""

GAIN_STEP_DB = 1.2
"""The largest change of gain from one frame to the next."""

DEAD_BAND = 0.03
"""The relative error of the mean, in either direction, that is left alone."""

SHORT_EXPOSURE_US = 5_000.0
"""What exposure is kept to under exposure priority while gain suffices (the camera's default)."""

LOWER_SHARE = 0.7
MIDDLE_SHARES: Mapping[Metering, float] = {"partial": 0.11, "spot": 0.03}
"""Shares of the picture's area, as the vendor describes its metering modes."""


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
    priority: Priority = "gain"

    def __post_init__(self) -> None:
        if not 0 < self.target_dn <= 255:
            raise ValueError(f"target_dn must be in (0, 255], got {self.target_dn!r}")
        if not 0 <= self.damping < 1:
            raise ValueError(f"damping must be in [0, 1), got {self.damping!r}")
        object.__setattr__(self, "settings", self.settings.clamp(self.limits))

    @classmethod
    def begun(cls, command: Auto) -> AutoExposure:
        """Return the state in which the law begins to obey a command."""
        return cls(
            command.limits, command.target_dn, command.damping, command.start, command.priority
        )

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

    def _turn_us(self) -> float:
        """Return the exposure at which gain takes over."""
        shortest_us, longest_us = self.limits.exposure_us
        if self.priority == "gain":
            return longest_us
        return min(max(SHORT_EXPOSURE_US, shortest_us), longest_us)

    def _on_program(self) -> bool:
        """Return whether the settings are those of their brightness: see `_program`."""
        exposure_us, gain = self.settings.exposure_us, self.settings.gain_db
        lowest_db, highest_db = self.limits.gain_db
        turn_us = self._turn_us()
        return (
            exposure_us == turn_us
            or (gain == lowest_db and exposure_us < turn_us)
            or (gain == highest_db and exposure_us > turn_us)
        )

    def _program(self, correction: float) -> Settings:
        """Return the settings of `correction` times the brightness.

        Exposure rises first, up to where gain takes over; then gain, up to its limit; then what is
        left of exposure.
        """
        now = self.settings
        brightness = now.exposure_us * gain_factor(now.gain_db) * correction
        shortest_us, longest_us = self.limits.exposure_us
        lowest_db, highest_db = self.limits.gain_db
        turn_us = self._turn_us()
        exposure_us = min(max(brightness / gain_factor(lowest_db), shortest_us), turn_us)
        if exposure_us < turn_us:
            return Settings(exposure_us, lowest_db)
        gain = min(max(gain_db(brightness / turn_us), lowest_db), highest_db)
        if gain == highest_db:
            exposure_us = min(max(brightness / gain_factor(gain), turn_us), longest_us)
        return Settings(exposure_us, gain)

    def _limit_step(self, wanted: Settings) -> Settings:
        """Return `wanted`, no farther from the present settings than one frame may go."""
        now = self.settings
        slowest, fastest = EXPOSURE_RATIO
        exposure_us = min(
            max(wanted.exposure_us, now.exposure_us * slowest), now.exposure_us * fastest
        )
        gain = min(max(wanted.gain_db, now.gain_db - GAIN_STEP_DB), now.gain_db + GAIN_STEP_DB)
        return Settings(exposure_us, max(gain, 0.0)).clamp(self.limits)


def metered_dn(image: NDArray[np.uint8], metering: Metering) -> float:
    """Return the mean grey, 0..255, of the part of a picture or a colour mosaic that counts."""
    return float(image[metered_part(image.shape, metering)].mean())


def metered_part(shape: tuple[int, ...], metering: Metering) -> tuple[slice, slice]:
    """Return the rows and columns that count; on even places, so that no colour is preferred."""
    height, width = shape[:2]
    if metering == "average":
        return slice(0, height), slice(0, width)
    if metering == "lower":
        return slice(_even(height * (1 - LOWER_SHARE)), height), slice(0, width)
    side = math.sqrt(MIDDLE_SHARES[metering])
    return _middle(height, side), _middle(width, side)


def _middle(length: int, share: float) -> slice:
    first = _even(length * (1 - share) / 2)
    return slice(first, length - first)


def _even(value: float) -> int:
    return 2 * round(value / 2)
