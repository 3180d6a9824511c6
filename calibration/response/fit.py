"""Finds the curve of a bracket.

The families that cameras have (linear, sRGB, gamma) are tried on the means of all steps. When none
fits, the curve is a table through the means. Debevec and Malik's method, which knows no black level
and works on single pixels, tells the gains for that, and is the second opinion on every curve.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import least_squares

from rig.calibration.response.curve import Curve, residual_dn
from rig.calibration.response.debevec import DebevecCurve, debevec_curve
from rig.calibration.response.step import Step, highest_dn, measurable
from rig.config import GammaResponse, LinearResponse, Response, SrgbResponse, TableResponse
from rig.core.errors import CalibrationError
from rig.core.units import gain_factor

GOOD_FIT_DN = 0.3
"""A family that is further from the means is not the camera's."""

Column = NDArray[np.float64]
Make = Callable[[Column], Response]

_FEWEST_STEPS = 10
_GAMMA = 2.2
_BLACK = 0.015
_FAR_FROM_ENDS = (0.25, 0.96)
_TABLE_STEPS = 256
_SAME_LIGHT = 0.02


def fit_curve(steps: Sequence[Step]) -> Curve:
    """Return the curve of a camera; raises CalibrationError for too few usable steps."""
    usable = measurable(steps)
    if len(usable) < _FEWEST_STEPS:
        raise CalibrationError(
            f"only {len(usable)} of {len(steps)} steps are neither black, white nor without noise, "
            f"at least {_FEWEST_STEPS} are needed; use a brighter, evenly lit surface"
        )
    linear = _fit_family(usable, lambda _: LinearResponse(), ())
    if residual_dn(linear, usable) <= GOOD_FIT_DN:
        return linear
    srgb = _fit_family(usable, lambda _: SrgbResponse(), ())
    gamma = _fit_family(usable, lambda shape: GammaResponse(gamma=float(shape[0])), (_GAMMA,))
    best = min((srgb, gamma), key=lambda curve: residual_dn(curve, usable))
    return best if residual_dn(best, usable) <= GOOD_FIT_DN else _make_table(steps, usable)


def debevec_difference_dn(steps: Sequence[Step]) -> float:
    """Return how far Debevec's curve is from the means, root-mean-square, away from both ends."""
    curve = debevec_curve(steps)
    lowest_db = min(step.gain_db for step in steps)
    usable = [step for step in measurable(steps) if step.gain_db == lowest_db]
    top_dn = _FAR_FROM_ENDS[1] * highest_dn(steps)
    off = [curve.dn(step.exposure_us) - step.mean_dn for step in usable if step.mean_dn < top_dn]
    return float(np.sqrt(np.mean(np.square(off))))


def _fit_family(usable: Sequence[Step], make: Make, shape: tuple[float, ...]) -> Curve:
    """Return the family's curve nearest to the means: rate at each gain, black level, shape."""
    gains_db = sorted({step.gain_db for step in usable})
    count = len(gains_db)

    def curve(values: Column) -> Curve:
        rates = np.exp(values[:count])
        gains = {gain: float(rate / rates[0]) for gain, rate in zip(gains_db, rates, strict=True)}
        return Curve(make(values[count + 1 :]), float(values[count]), float(rates[0]), gains)

    def off(values: Column) -> Column:
        tried = curve(values)
        return np.array([tried.mean_dn(step) - step.mean_dn for step in usable])

    rate = 1 / max(step.light_us for step in usable)
    start = [math.log(rate * gain_factor(gain)) for gain in gains_db] + [_BLACK, *shape]
    low = [-math.inf] * count + [0.0] + [1.01] * len(shape)
    high = [math.inf] * count + [0.5] + [6.0] * len(shape)
    return curve(least_squares(off, start, bounds=(low, high), x_scale="jac").x)


def _make_table(steps: Sequence[Step], usable: Sequence[Step]) -> Curve:
    """Return the curve as a table: a smooth, never falling line through the means.

    The level below the black level sees no light, so nothing tells the response there: it is the
    straight line from zero that goes on with the slope of the curve at the black level.
    """
    top_dn = highest_dn(steps)
    gains = _gains(debevec_curve(steps), usable, top_dn)
    lights_us, values_dn = _anchors(usable, gains)
    full_us = _extrapolated_us(lights_us, values_dn, top_dn)
    black_dn, slope = _dark_end(usable, gains)
    share = black_dn / (full_us * slope)
    black = share / (1 + share)
    rate = (1 - black) / full_us
    line = PchipInterpolator([0.0, *lights_us, full_us], [black_dn, *values_dn, top_dn])
    levels = np.linspace(0, 1, _TABLE_STEPS + 1)
    seen_us = np.clip((levels - black) / rate, 0, full_us)
    table_dn = np.where(levels < black, black_dn * levels / max(black, 1e-9), line(seen_us))
    rising = np.clip(np.maximum.accumulate(table_dn) / 255, 0, 1)
    return Curve(TableResponse(table=tuple(rising.tolist())), black, rate, gains)


def _anchors(usable: Sequence[Step], gains: dict[float, float]) -> tuple[Column, Column]:
    """Return lights and means, each light once: of the lowest gain at which it was measurable."""
    points: dict[float, float] = {}
    for step in sorted(usable, key=lambda step: step.gain_db):
        light_us = step.exposure_us * gains[step.gain_db]
        if all(abs(light_us - known) > _SAME_LIGHT * known for known in points):
            points[light_us] = step.mean_dn
    lights_us = sorted(points)
    return np.array(lights_us), np.array([points[light_us] for light_us in lights_us])


def _extrapolated_us(lights_us: Column, values_dn: Column, top_dn: float) -> float:
    """Return the exposure at which a camera saturates, by a line through the last values."""
    (first_us, last_us), (first_dn, last_dn) = lights_us[-2:], values_dn[-2:]
    return float(last_us + (top_dn - last_dn) * (last_us - first_us) / (last_dn - first_dn))


def _dark_end(usable: Sequence[Step], gains: dict[float, float]) -> tuple[float, float]:
    """Return the grey value without light, and its rise per microsecond at the lowest gain."""
    highest = max(gains)
    steps = [step for step in usable if step.gain_db == highest]
    one, two = sorted(steps, key=lambda step: step.exposure_us)[:2]
    rise = (two.mean_dn - one.mean_dn) / (two.exposure_us - one.exposure_us)
    return max(one.mean_dn - rise * one.exposure_us, 0.0), rise / gains[highest]


def _gains(found: DebevecCurve, usable: Sequence[Step], top_dn: float) -> dict[float, float]:
    """Return the factor of each gain: how much longer the lowest one must expose for the same."""
    gains: dict[float, list[float]] = {}
    for step in usable:
        if _FAR_FROM_ENDS[0] * top_dn < step.mean_dn < _FAR_FROM_ENDS[1] * top_dn:
            light_us = float(np.interp(step.mean_dn, np.arange(256), found.light_us))
            gains.setdefault(step.gain_db, []).append(light_us / step.exposure_us)
    medians = {gain: float(np.median(factors)) for gain, factors in gains.items()}
    lowest = medians[min(medians)]
    return {gain: factor / lowest for gain, factor in medians.items()}
