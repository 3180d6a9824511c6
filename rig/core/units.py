"""Conversions between the units that appear in names."""

from __future__ import annotations

import math

NS_PER_S = 1_000_000_000
NS_PER_US = 1_000
US_PER_S = 1_000_000


def gain_factor(gain_db: float) -> float:
    """Return the linear amplification of a gain in dB: 20 dB is tenfold (EMVA 1288)."""
    return math.pow(10.0, gain_db / 20.0)


def gain_db(factor: float) -> float:
    """Return the gain in dB of a linear amplification > 0."""
    return 20.0 * math.log10(factor)


def us_to_ns(duration_us: float) -> int:
    """Return a duration in whole nanoseconds."""
    return round(duration_us * NS_PER_US)


def s_to_ns(duration_s: float) -> int:
    """Return a duration in whole nanoseconds."""
    return round(duration_s * NS_PER_S)
