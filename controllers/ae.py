"""The camera's built-in automatic exposure at a fixed gain, AE, as the thesis' rival (5.2)."""

from __future__ import annotations

from dataclasses import dataclass, field

from rig.controllers.aeag import AeagController
from rig.core.types import Command, Diagnostics, Frame, Limits


@dataclass(slots=True)
class AeController:
    """Leaves exposure to the camera and keeps `gain_db`, or the nearest gain that there is.

    `target_dn` is the mean grey to aim for, in (0, 255]; `damping` in [0, 1) the share of each
    correction that is held back; `exposure_us_max` caps the exposure below the camera's limit;
    `metering` is the part of the picture that counts: average, lower, partial or spot.
    Raises ValueError when one is out of range.
    """

    gain_db: float = 20.0
    target_dn: float = 140.0
    damping: float = 0.0
    exposure_us_max: float = 4_000.0
    metering: str = "average"
    start_us: float = 1_000.0
    _both: AeagController = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._both = AeagController(
            self.target_dn,
            self.damping,
            self.exposure_us_max,
            self.metering,
            start_us=self.start_us,
            start_db=self.gain_db,
        )

    def reset(self, limits: Limits) -> Command:
        """Return the command; raises ControllerError when no exposure is left under the cap."""
        lowest_db, highest_db = limits.gain_db
        gain_db = min(max(self.gain_db, lowest_db), highest_db)
        return self._both.reset(Limits(limits.exposure_us, (gain_db, gain_db)))

    def step(self, frame: Frame) -> Command:
        """Return the same command again: the camera keeps its own state."""
        return self._both.step(frame)

    def diagnostics(self) -> Diagnostics:
        """Return nothing: the camera's used settings say what it did."""
        return {}
