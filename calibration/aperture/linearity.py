"""Whether two cameras stay alike at other exposures: three of them, and a line for each camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.core.types import Pair

LINEARITY_STOPS = 0.05

_LEAST_DN = 0.1


@dataclass(frozen=True, slots=True)
class Linearity:
    """A straight line for each camera, and the ratio of light that their slopes come to.

    `worst_stops` is the largest distance of a signal from its camera's line; `ratios_stops` is
    the ratio at each exposure. `error_stops` is one standard deviation of `ratio_stops`: what the
    frames' noise and the spread over the exposures come to.
    """

    exposures_us: tuple[float, ...]
    black_dn: Pair[float]
    worst_stops: float
    ratios_stops: tuple[float, ...]
    ratio_stops: float
    error_stops: float


def linearity(
    exposures_us: Sequence[float], means_dn: Sequence[Pair[float]], errors_dn: Sequence[Pair[float]]
) -> Linearity:
    """Return how well the mean grey values, with their standard errors, follow the exposures."""
    times = np.array(exposures_us)
    leverage = (times - times.mean()) / np.square(times - times.mean()).sum()
    signals, blacks, slopes, worst, error = [], [], [], 0.0, 0.0
    for side in range(2):
        values = np.array([means[side] for means in means_dn])
        slope, black = np.polyfit(times, values, 1)
        signal = np.maximum(values - black, _LEAST_DN)
        off = np.abs(np.log2(signal / np.maximum(slope * times, _LEAST_DN)))
        worst = max(worst, float(off.max()))
        noise = np.array([errors[side] for errors in errors_dn])
        share = float(np.linalg.norm(leverage * noise)) / max(abs(float(slope)), 1e-12)
        error = math.hypot(error, share / math.log(2))
        signals.append(signal)
        slopes.append(max(float(slope), 1e-12))
        blacks.append(float(black))
    ratios = np.log2(signals[1] / signals[0])
    return Linearity(
        exposures_us=tuple(times.tolist()),
        black_dn=Pair(*blacks),
        worst_stops=worst,
        ratios_stops=tuple(ratios.tolist()),
        ratio_stops=math.log2(slopes[1] / slopes[0]),
        error_stops=math.hypot(error, float(np.std(ratios, ddof=1))),
    )
