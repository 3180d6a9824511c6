"""Finds one setting for both cameras at which the brighter one is bright and not saturated."""

from __future__ import annotations

from dataclasses import dataclass

from rig.calibration.aperture.reading import MOST_SATURATED
from rig.calibration.aperture.surface import Look
from rig.core.errors import CalibrationError
from rig.core.types import Limits, Pair, Settings
from rig.core.units import gain_db, gain_factor

BRIGHT_DN = 130.0

_CLOSE_ENOUGH = (0.85, 1.2)
_STAY_WITHIN = (0.5, 1.4)
_LESS, _MUCH_LESS, _MUCH_MORE = 0.5, 0.3, 8.0
_TRIES = 20


@dataclass(slots=True)
class Meter:
    """Chooses `settings`: the exposure first, gain only where the exposure is at its end.

    Two exposures, one double the other, tell each camera's black level, for a linear response.
    """

    settings: Settings
    limits: Limits
    black_dn: Pair[float] | None = None
    _bright: tuple[float, Pair[float]] | None = None
    _tries: int = 0

    def see(self, looks: Pair[Look]) -> None:
        """Take the looks at pictures taken with `settings`, and choose the next.

        Raises CalibrationError when no setting suits.
        """
        self._tries += 1
        if self._tries > _TRIES:
            raise CalibrationError(_why_not(looks))
        means = Pair(*(each.mean_dn for each in looks))
        if self._bright is not None:
            self._finish(means, *self._bright)
        elif _too_bright(looks):
            self._expose(_MUCH_LESS)
        else:
            self._approach(means)

    def follow(self, looks: Pair[Look]) -> None:
        """Keep the pictures bright while somebody turns the ring; the ratio does not mind."""
        share = max(each.mean_dn for each in looks) / BRIGHT_DN
        if not _STAY_WITHIN[0] < share < _STAY_WITHIN[1]:
            self._expose(min(max(1 / max(share, 1e-3), _MUCH_LESS), _MUCH_MORE))

    def _approach(self, means: Pair[float]) -> None:
        wanted = BRIGHT_DN / max(*means, 1.0)
        if _CLOSE_ENOUGH[0] < wanted < _CLOSE_ENOUGH[1] or self._at_the_end(wanted):
            self._bright = self.settings.exposure_us, means
            self.settings = Settings(
                round(_LESS * self.settings.exposure_us), self.settings.gain_db
            )
        else:
            self._expose(min(wanted, _MUCH_MORE))

    def _finish(self, means: Pair[float], exposure_us: float, bright: Pair[float]) -> None:
        share = self.settings.exposure_us / exposure_us
        self.black_dn = Pair(
            *((mean - share * b) / (1 - share) for mean, b in zip(means, bright, strict=True))
        )
        self.settings = Settings(exposure_us, self.settings.gain_db)

    def _at_the_end(self, wanted: float) -> bool:
        longest_us, most_db = self.limits.exposure_us[1], self.limits.gain_db[1]
        at_most = self.settings.exposure_us >= longest_us and self.settings.gain_db >= most_db
        return wanted > 1 and at_most

    def _expose(self, factor: float) -> None:
        """Change the light in the picture by `factor`, as far as the limits allow."""
        shortest_us, longest_us = self.limits.exposure_us
        least_db, most_db = self.limits.gain_db
        wanted_us = self.settings.exposure_us * gain_factor(self.settings.gain_db) * factor
        exposure_us = min(max(round(wanted_us / gain_factor(least_db)), shortest_us), longest_us)
        gain = gain_db(wanted_us / exposure_us) if exposure_us >= longest_us else least_db
        self.settings = Settings(float(exposure_us), min(max(round(gain, 1), least_db), most_db))


def _too_bright(looks: Pair[Look]) -> bool:
    return max(each.saturated for each in looks) > MOST_SATURATED


def _why_not(looks: Pair[Look]) -> str:
    return (
        "the surface is too bright even at the shortest exposure: take light away"
        if _too_bright(looks)
        else "the pictures do not settle: is the light steady, and is the surface blank?"
    )
