"""Exposure by gradient information: try brightness by gamma curves (Shim et al. 2014 and 2018).

Seven gamma curves make darker and brighter pictures of a frame; a polynomial of fifth order through
their gradient information says at which gamma it were most, and exposure moves that way.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from rig.controllers.split import check_gain, scaled, towards_middle
from rig.core.types import THESIS_LIMITS, Command, Diagnostics, Frame, Limits, Settings
from rig.vision.metrics import mean_dn, sample, sampled_information

GAMMAS: Mapping[int, tuple[float, ...]] = {
    2014: (0.1, 0.5, 0.8, 1.0, 1.2, 1.5, 1.9),
    2018: (1 / 1.9, 1 / 1.5, 1 / 1.2, 1.0, 1.2, 1.5, 1.9),
}
DEGREE = 5
GAMMA_STEP = 0.01
DEAD_BAND = 0.025
"""A best gamma this near to 1 is left alone: the polynomial knows it no better."""
TILES_ACROSS = 22


@dataclass(slots=True)
class ShimController:
    """Moves exposure to where the gamma-corrected pictures have most gradient information.

    `version` is 2014 (linear update) or 2018 (tangent update with `d`); `kp` is the gain of the
    update, halved when darkening. `gain` fixed leaves gain at `gain_db`, split lets exposure go up
    to `exposure_us_max` and gain take the rest. A frame without gradients moves the mean to
    mid-grey instead. Raises ValueError for an option out of range.
    """

    PRESETS: ClassVar[Mapping[str, Mapping[str, Mapping[str, str]]]] = {
        "version": {"2014": {"kp": "0.2"}}
    }

    version: int = 2018
    kp: float = 1.6
    d: float = 0.1
    gain: str = "fixed"
    gain_db: float = 10.0
    exposure_us_max: float = THESIS_LIMITS.exposure_us[1]
    _limits: Limits = field(init=False, default=THESIS_LIMITS)
    _tables: list[NDArray[np.uint8]] = field(init=False, repr=False)
    _gamma: float = field(init=False, default=1.0)
    _information: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        if self.version not in GAMMAS:
            raise ValueError(f"version must be 2014 or 2018, got {self.version!r}")
        if not 0 < self.kp < math.inf:
            raise ValueError(f"kp must be > 0, got {self.kp!r}")
        if not 0 < self.d < math.inf:
            raise ValueError(f"d must be > 0, got {self.d!r}")
        check_gain(self.gain, self.exposure_us_max)
        Settings(1.0, self.gain_db)
        levels = np.arange(256) / 255
        self._tables = [
            np.rint(255 * levels**gamma).astype(np.uint8) for gamma in GAMMAS[self.version]
        ]

    def reset(self, limits: Limits) -> Command:
        """Begin at 1 ms and the fixed gain, or as near to it as the camera can."""
        self._limits = limits
        self._gamma, self._information = 1.0, 0.0
        return Settings(1_000.0, self.gain_db).clamp(limits)

    def step(self, frame: Frame) -> Command:
        """Return the next exposure."""
        part = sample(frame.image, frame.pixel_format, TILES_ACROSS)
        grey = part.grey()
        information = [sampled_information(table[grey], part.places) for table in self._tables]
        gammas = GAMMAS[self.version]
        self._information = information[gammas.index(1.0)]
        if max(information) == 0:
            factor = towards_middle(mean_dn(frame.image))
            return scaled(frame.used, factor, self._limits, self.gain, self.exposure_us_max)
        self._gamma = best_gamma(gammas, information)
        if abs(self._gamma - 1) <= DEAD_BAND:
            return frame.used.clamp(self._limits)
        factor = self._factor(self._gamma)
        return scaled(frame.used, factor, self._limits, self.gain, self.exposure_us_max)

    def diagnostics(self) -> Diagnostics:
        """Return the best gamma and the information of the frame as it is, 0..1 a pixel."""
        return {"gamma": self._gamma, "information": self._information}

    def _factor(self, gamma: float) -> float:
        """Return the change of exposure (thesis eq. 3.3; the 2018 form replaces 1 - gamma)."""
        alpha = 0.5 if gamma >= 1 else 1.0
        if self.version == 2014:
            return 1 + alpha * self.kp * (1 - gamma)
        turn = math.atan(1 / self.d)
        response = self.d * math.tan((2 - gamma) * turn - turn)
        return max(1 + alpha * self.kp * response, 0.1)


def best_gamma(gammas: tuple[float, ...], information: list[float]) -> float:
    """Return where the polynomial through the information is largest, inside the gammas tried."""
    fit = Polynomial.fit(gammas, information, DEGREE)
    tried = np.arange(gammas[0], gammas[-1] + GAMMA_STEP / 2, GAMMA_STEP)
    return float(tried[int(np.argmax(fit(tried)))])
