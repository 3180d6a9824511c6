"""Both pictures together: how much more light the secondary gets, and what to do about it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rig.calibration.aperture.surface import Look
from rig.core.types import Pair

TOLERANCE_STOPS = 0.02
"""One and a half per cent of light: below what exposure steps and lamps do."""

MOST_SATURATED = 0.001
MOST_UNEVEN = 0.1
FEWEST_DN = 20.0

_LEAST_SIGNAL_DN = 0.25


@dataclass(frozen=True, slots=True)
class Reading:
    """The secondary's light over the primary's, in stops, and the pictures that say so."""

    ratio_stops: float
    looks: Pair[Look]

    @property
    def warnings(self) -> list[str]:
        """Return what speaks against the reading, and what to do."""
        told = []
        if max(each.saturated for each in self.looks) > MOST_SATURATED:
            told.append("saturated: take light away")
        if min(each.mean_dn for each in self.looks) < FEWEST_DN:
            told.append("too dark: add light")
        if max(each.uneven for each in self.looks) > MOST_UNEVEN:
            told.append("uneven surface: light it from both sides, or come closer")
        return told


def ratio_stops(means_dn: Pair[float], black_dn: Pair[float]) -> float:
    """Return log2 of the secondary's signal over the primary's, black levels taken off."""
    primary, secondary = (
        max(mean - black, _LEAST_SIGNAL_DN) for mean, black in zip(means_dn, black_dn, strict=True)
    )
    return math.log2(secondary / primary)


def direction(stops: float, tolerance_stops: float) -> str:
    """Return which way to turn the ring of the secondary camera: OPEN, CLOSE or HOLD."""
    if abs(stops) <= tolerance_stops:
        return "HOLD"
    return "CLOSE" if stops > 0 else "OPEN"
