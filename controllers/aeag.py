"""The camera's built-in automatic exposure and gain, AE+AG, as the thesis' rival (thesis 5.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from rig.core.autoexposure import AutoExposure
from rig.core.errors import ControllerError
from rig.core.types import THESIS_LIMITS, Auto, Command, Diagnostics, Frame, Limits, Settings


@dataclass(slots=True)
class AeagController:
    """Leaves exposure and gain to the camera.

    `target_dn` is the mean grey to aim for, in (0, 255]; `damping` in [0, 1) the share of each
    correction that is held back; `exposure_us_max` caps the exposure below the camera's limit;
    `start_us` and `start_db` are where the camera begins. Raises ValueError when one is out of
    range.
    """

    PRESETS: ClassVar[Mapping[str, Mapping[str, Mapping[str, str]]]] = {
        "preset": {
            "tuned": {},
            "vendor": {"target_dn": "110", "damping": "0.5", "exposure_us_max": "30000"},
        }
    }

    target_dn: float = 110.0
    damping: float = 0.5
    exposure_us_max: float = THESIS_LIMITS.exposure_us[1]
    start_us: float = 1_000.0
    start_db: float = 0.0
    _command: Auto = field(init=False)

    def __post_init__(self) -> None:
        start = Settings(self.start_us, self.start_db)
        AutoExposure(THESIS_LIMITS, self.target_dn, self.damping, start)
        if not self.exposure_us_max > 0:
            raise ValueError(f"exposure_us_max must be > 0, got {self.exposure_us_max!r}")
        self._command = Auto(THESIS_LIMITS, self.target_dn, self.damping, start)

    def reset(self, limits: Limits) -> Command:
        """Return the command; raises ControllerError when no exposure is left under the cap."""
        shortest_us, longest_us = limits.exposure_us
        if self.exposure_us_max < shortest_us:
            raise ControllerError(
                f"aeag: exposure_us_max={self.exposure_us_max:g} is below the camera's shortest "
                f"exposure, {shortest_us:g} us; raise the cap"
            )
        capped = Limits((shortest_us, min(longest_us, self.exposure_us_max)), limits.gain_db)
        start = Settings(self.start_us, self.start_db).clamp(capped)
        self._command = Auto(capped, self.target_dn, self.damping, start)
        return self._command

    def step(self, frame: Frame) -> Command:
        """Return the same command again: the camera keeps its own state."""
        return self._command

    def diagnostics(self) -> Diagnostics:
        """Return nothing: the camera's used settings say what it did."""
        return {}
