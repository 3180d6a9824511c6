"""The response curve of a camera, as the simulation knows it: response, black level, light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.calibration.response.step import Step
from rig.config import Response
from rig.drivers.sensor.sensor import response_curve

Column = NDArray[np.float64]

_HALF_STEP = 1e-3
_LEAST_SLOPE_DN = 1.0
_ROUNDS = 3
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
_SHARES = _WEIGHTS / _WEIGHTS.sum()
"""Gauss-Hermite quadrature: the mean of a function over a normal distribution."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """From light to grey values: dn = 255 response(black + rate_per_us * exposure_us * gain).

    The level that the response takes, 0..1, is a share of the converter's range. `gains` are the
    factors that the camera really has at the gains of the bracket in dB, 1 at the lowest.
    """

    response: Response
    black: float
    rate_per_us: float
    gains: Mapping[float, float]

    def level(self, step: Step) -> float:
        """Return the level that a step's light comes to."""
        return self.black + self.rate_per_us * step.exposure_us * self.gains[step.gain_db]

    def dn(self, levels: Column) -> Column:
        """Return the grey values of levels; those above 1 go on as the formula does."""
        return 255 * response_curve(self.response, np.maximum(levels, 0.0))

    def slope_dn(self, level: float) -> float:
        """Return the grey values per level."""
        ends = np.maximum(np.array([level - _HALF_STEP, level + _HALF_STEP]), 0.0)
        return float(np.diff(self.dn(ends))[0] / np.diff(ends)[0])

    def mean_dn(self, step: Step) -> float:
        """Return the mean that a step must have: of the curve, over the step's own noise."""
        level = self.level(step)
        noise = step.noise_dn / max(self.slope_dn(level), _LEAST_SLOPE_DN)
        return float(_SHARES @ self.dn(level + noise * _NODES))

    def level_noise(self, level: float, noise_dn: float) -> float:
        """Return the noise of a level that comes to `noise_dn` behind the curve, bent or not."""
        noise = noise_dn / max(self.slope_dn(level), _LEAST_SLOPE_DN)
        for _ in range(_ROUNDS):
            values = self.dn(level + noise * _NODES)
            spread_dn = float(np.sqrt(_SHARES @ (values - _SHARES @ values) ** 2))
            noise *= noise_dn / max(spread_dn, 1e-9)
        return noise


def residual_dn(curve: Curve, steps: list[Step]) -> float:
    """Return the root-mean-square difference between a curve and the means of steps."""
    return float(np.sqrt(np.mean([(curve.mean_dn(step) - step.mean_dn) ** 2 for step in steps])))
