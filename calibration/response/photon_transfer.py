"""Photon transfer (EMVA 1288): what the noise tells of electrons."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.calibration.response.curve import Curve
from rig.calibration.response.step import Step, highest_dn, measurable

Column = NDArray[np.float64]

_ROUNDING = 1 / 12
"""Variance of rounding to whole steps."""

_ROUNDS = 5
_SPREADS = 3.0


@dataclass(frozen=True, slots=True)
class PhotonTransfer:
    """What a bracket's noise tells, at the lowest of its gains.

    `level_per_e` is the share of the converter's range that an electron fills, `full_well_e` what
    fills it all: of a camera that goes down to 0 dB its full well.
    `scatter` is the root-mean-square relative distance of the steps' variances from the line.
    """

    level_per_e: float
    read_noise_e: float
    full_well_e: float
    scatter: float


def photon_transfer(steps: Sequence[Step], curve: Curve, bits: int) -> PhotonTransfer:
    """Return conversion gain, read noise and full well.

    On the level before the response a variance is K G (level - black) + K^2 G^2 r^2, with K levels
    per electron, gain G and read noise r, once the rounding of the picture's 8 bits and of the
    converter's `bits` is taken off. Divided by G it is a plane over signal and gain, whose
    two slopes are found by least squares of relative distances.
    """
    rounding = _ROUNDING / ((1 << bits) - 1) ** 2
    rows, variances = [], []
    for step in measurable(steps):
        gain, level = curve.gains[step.gain_db], curve.level(step)
        noise_dn = math.sqrt(step.noise_dn**2 - _ROUNDING)
        variance = curve.level_noise(level, noise_dn) ** 2 - rounding
        variances.append(max(variance, 1e-12) / gain)
        rows.append([level - curve.black, gain])
    (per_e, read), scatter = _fit_plane(np.array(rows), np.array(variances))
    return PhotonTransfer(
        level_per_e=per_e,
        read_noise_e=math.sqrt(max(read, 0.0)) / per_e,
        full_well_e=(_full_level(steps, curve) - curve.black) / per_e,
        scatter=scatter,
    )


def _fit_plane(plane: Column, seen: Column) -> tuple[tuple[float, float], float]:
    """Return the slopes of relative least squares, and the scatter around them.

    Steps far off are left out: where little noise meets the rounding of the converter and that of
    8 bits, one after the other, a variance can be a third off.
    """
    kept, expected = np.ones(len(seen), bool), seen
    for _ in range(_ROUNDS):
        rows, weights = plane[kept], 1 / expected[kept]
        slopes, *_ = np.linalg.lstsq(rows * weights[:, None], seen[kept] * weights)
        expected = np.maximum(plane @ slopes, 1e-3 * seen)
        off = np.abs(seen / expected - 1)
        kept = off <= _SPREADS * 1.4826 * np.median(off)
    scatter = float(np.sqrt(np.mean(off[kept] ** 2)))
    return (float(slopes[0]), float(slopes[1])), scatter


def _full_level(steps: Sequence[Step], curve: Curve) -> float:
    """Return the level that no light exceeds: where the well, or the converter, is full."""
    levels = np.linspace(0, 1, 4097)
    top_dn = highest_dn(steps)
    return float(np.interp(top_dn, curve.dn(levels), levels))
