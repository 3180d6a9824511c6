"""The control experiment: settings that never change."""

from __future__ import annotations

from dataclasses import dataclass, field

from rig.core.errors import ControllerError
from rig.core.types import Command, Diagnostics, Frame, Limits, Settings


@dataclass(slots=True)
class FixedController:
    """Keeps `exposure_us` and `gain_db`; raises ValueError when they are no settings."""

    exposure_us: float = 500.0
    gain_db: float = 10.0
    _settings: Settings = field(init=False)

    def __post_init__(self) -> None:
        self._settings = Settings(self.exposure_us, self.gain_db)

    def reset(self, limits: Limits) -> Command:
        """Return the settings; raises ControllerError when the camera cannot take them."""
        if self._settings.clamp(limits) != self._settings:
            raise ControllerError(
                f"fixed: {self.exposure_us:g} us and {self.gain_db:g} dB are outside the camera's "
                f"{limits}; choose settings inside"
            )
        return self._settings

    def step(self, frame: Frame) -> Command:
        """Return the same settings again."""
        return self._settings

    def diagnostics(self) -> Diagnostics:
        """Return nothing: nothing was thought."""
        return {}
