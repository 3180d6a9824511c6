"""The camera's built-in automatic exposure and gain, AE+AG, as the thesis' rival (thesis 5.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, cast

from rig.core.autoexposure import AutoExposure
from rig.core.errors import ControllerError
from rig.core.types import (
    THESIS_LIMITS,
    Auto,
    Command,
    Diagnostics,
    Frame,
    Limits,
    Metering,
    Priority,
    Settings,
)


@dataclass(slots=True)
class AeagController:
    """Leaves exposure and gain to the camera.

    `target_dn` is the mean grey to aim for, in (0, 255]; `damping` in [0, 1) the share of each
    correction that is held back; `exposure_us_max` caps the exposure below the camera's limit;
    `metering` is the part of the picture that counts (average, lower, partial or spot) and
    `priority` what is kept low (gain or exposure), as in `Auto`; `start_us` and `start_db` are
    where the camera begins. Raises ValueError when one is out of range.
    """

    PRESETS: ClassVar[Mapping[str, Mapping[str, Mapping[str, str]]]] = {
        "preset": {
            "tuned": {},
            "vendor": {
                "target_dn": "110",
                "damping": "0.5",
                "exposure_us_max": "30000",
                "metering": "average",
                "priority": "gain",
            },
        }
    }

    target_dn: float = 155.0
    damping: float = 0.3
    exposure_us_max: float = 4_000.0
    metering: str = "partial"
    priority: str = "gain"
    start_us: float = 1_000.0
    start_db: float = 0.0
    _command: Auto = field(init=False)

    def __post_init__(self) -> None:
        if not self.exposure_us_max > 0:
            raise ValueError(f"exposure_us_max must be > 0, got {self.exposure_us_max!r}")
        self._command = self._within(THESIS_LIMITS)
        AutoExposure.begun(self._command)

    def reset(self, limits: Limits) -> Command:
        """Return the command; raises ControllerError when no exposure is left under the cap."""
        shortest_us, longest_us = limits.exposure_us
        if self.exposure_us_max < shortest_us:
            raise ControllerError(
                f"aeag: exposure_us_max={self.exposure_us_max:g} is below the camera's shortest "
                f"exposure, {shortest_us:g} us; raise the cap"
            )
        capped = Limits((shortest_us, min(longest_us, self.exposure_us_max)), limits.gain_db)
        self._command = self._within(capped)
        return self._command

    def step(self, frame: Frame) -> Command:
        """Return the same command again: the camera keeps its own state."""
        return self._command

    def diagnostics(self) -> Diagnostics:
        """Return nothing: the camera's used settings say what it did."""
        return {}

    def _within(self, limits: Limits) -> Auto:
        return Auto(
            limits,
            self.target_dn,
            self.damping,
            Settings(self.start_us, self.start_db).clamp(limits),
            cast("Metering", self.metering),
            cast("Priority", self.priority),
        )
