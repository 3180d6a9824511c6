"""From a brightness, exposure times gain factor, to one exposure and one gain.

The exposure-value split: exposure takes all of it up to a cap against motion blur, gain what is
left. So gain rises last and falls first.
"""

from __future__ import annotations

from rig.core.autoexposure import EXPOSURE_RATIO
from rig.core.types import Limits, Settings
from rig.core.units import gain_db, gain_factor

MIDDLE_DN = 128.0

GAINS = ("fixed", "split")
"""How a method that moves exposure alone treats gain: leaves it, or takes it by the split."""


def brightness_us(settings: Settings) -> float:
    """Return exposure x gain factor: the exposure that were as bright at 0 dB, in us."""
    return settings.exposure_us * gain_factor(settings.gain_db)


def split(wanted_us: float, limits: Limits, exposure_us_max: float) -> Settings:
    """Return the settings of a brightness > 0 with the least gain; the nearest there are."""
    shortest_us, longest_us = limits.exposure_us
    cap_us = max(min(exposure_us_max, longest_us), shortest_us)
    least_gain = gain_factor(limits.gain_db[0])
    exposure_us = min(max(wanted_us / least_gain, shortest_us), cap_us)
    gain = max(wanted_us / exposure_us, 1.0)
    return Settings(exposure_us, gain_db(gain)).clamp(limits)


def scaled(
    used: Settings, factor: float, limits: Limits, gain: str, exposure_us_max: float
) -> Settings:
    """Return settings `factor` times as bright: by exposure, or by both where split."""
    if gain == "split":
        return split(brightness_us(used) * factor, limits, exposure_us_max)
    longest_us = max(min(exposure_us_max, limits.exposure_us[1]), limits.exposure_us[0])
    return Settings(min(used.exposure_us * factor, longest_us), used.gain_db).clamp(limits)


def towards_middle(mean_dn: float) -> float:
    """Return the change of brightness, no more than the built-in law's, that nears mid-grey.

    For frames in which a method sees nothing.
    """
    slowest, fastest = EXPOSURE_RATIO
    return min(max(MIDDLE_DN / max(mean_dn, 1.0), slowest), fastest)


def check_gain(gain: str, exposure_us_max: float) -> None:
    """Raise ValueError unless the option `gain` is known and the cap is above 0."""
    if gain not in GAINS:
        raise ValueError(f"gain must be {' or '.join(GAINS)}, got {gain!r}")
    check_cap(exposure_us_max)


def check_cap(exposure_us_max: float) -> None:
    """Raise ValueError unless the cap is above 0."""
    if not exposure_us_max > 0:
        raise ValueError(f"exposure_us_max must be > 0, got {exposure_us_max!r}")
