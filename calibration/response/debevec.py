"""Debevec and Malik's response curve (SIGGRAPH 1997) from a bracket, as OpenCV has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.calibration.response.step import PATCH_PX, Step, highest_dn

Column = NDArray[np.float64]

_SMOOTHNESS = 30.0
_SAMPLES = 100
_MIDDLE_DN = 127
_FROM_ENDS_DN = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class DebevecCurve:
    """`light_us` is, for each grey value 0..255, the exposure that gives it; it never falls."""

    light_us: Column

    def dn(self, exposure_us: float) -> float:
        """Return the grey value that an exposure gives."""
        return float(np.interp(exposure_us, self.light_us, np.arange(256)))


def debevec_curve(steps: Sequence[Step]) -> DebevecCurve:
    """Return the curve of the steps that were taken at the lowest gain.

    The method knows the light up to a factor; the exposure of the middle grey value gives it.
    It knows no black level and no end of the light, so steps that show little else are left out.
    """
    gain_db = min(step.gain_db for step in steps)
    lowest_dn = min(step.mean_dn for step in steps) + _FROM_ENDS_DN
    top_dn = highest_dn(steps) - _FROM_ENDS_DN
    bracket = {
        step.exposure_us: step
        for step in steps
        if step.gain_db == gain_db and lowest_dn < step.mean_dn < top_dn
    }
    ordered = [bracket[exposure_us] for exposure_us in sorted(bracket)]
    times_us = np.array([step.exposure_us for step in ordered])
    pictures = [cv2.merge([step.patch] * 3) for step in ordered]
    assert pictures[0].shape[:2] == (PATCH_PX, PATCH_PX)
    method = cv2.createCalibrateDebevec(_SAMPLES, _SMOOTHNESS, False)
    found = method.process(pictures, np.asarray(times_us * 1e-6, np.float32))
    relative = np.asarray(found, np.float64)[:, 0, 0]
    middle_us = np.interp(_MIDDLE_DN, [step.mean_dn for step in ordered], times_us)
    light_us = np.maximum.accumulate(relative * middle_us / relative[_MIDDLE_DN])
    return DebevecCurve(np.asarray(light_us, np.float64))
