"""How the second camera of `rig collect` strays from the first (thesis 4.2.2)."""

from __future__ import annotations

from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Protocol

import numpy as np

from rig.core.errors import UsageError
from rig.core.types import Diagnostics, Frame, Limits, Settings
from rig.vision.metrics import mean_dn

STRAY = 0.5
"""The largest relative change of exposure or gain (thesis eq. 4.1)."""

SMALL_DB, LARGE_DB = (0.0, 2.0), (5.0, 10.0)
"""What is added to a gain of 0 dB, which scaling cannot move (thesis 4.2.2)."""

MIDDLE_DN = 128.0
"""Brighter pictures than this are darkened, the others brightened (thesis eq. 4.2)."""

QUADRANTS = ((+1, +1), (+1, -1), (-1, -1), (-1, +1))
"""The directions of (exposure, gain), one per frame."""


class Perturbation(Protocol):
    """Settings near those that the leading camera really used."""

    @property
    def name(self) -> str:
        """Return the word by which the perturbation is asked for."""
        ...

    def reset(self, limits: Limits) -> None:
        """Start over, for a camera with these limits."""
        ...

    def near(self, leader: Frame) -> Settings:
        """Return settings near those that `leader` was taken with."""
        ...

    def diagnostics(self) -> Diagnostics:
        """Return the directions that were taken last."""
        ...


@dataclass(slots=True)
class FourQuadrants:
    """More and less exposure with more and less gain, all four once in four frames (eq. 4.1)."""

    seed: int
    name: str = field(init=False, default="cycle")
    _limits: Limits = field(init=False)
    _random: np.random.Generator = field(init=False, repr=False)
    _frames: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self.reset(Limits())

    def reset(self, limits: Limits) -> None:
        """Start over with the first quadrant and the same random numbers."""
        self._limits = limits
        self._random = np.random.default_rng(self.seed)
        self._frames = 0

    def near(self, leader: Frame) -> Settings:
        """Return settings in the next quadrant around those used."""
        exposure, gain = QUADRANTS[self._frames % len(QUADRANTS)]
        self._frames += 1
        return stray(leader.used, exposure, gain, self._random).clamp(self._limits)

    def diagnostics(self) -> Diagnostics:
        """Return the quadrant that was taken last, 0..3."""
        return {"quadrant": float((self._frames - 1) % len(QUADRANTS))}


@dataclass(slots=True)
class MeanIntensity:
    """Both settings up after a dark picture and down after a bright one (eq. 4.2)."""

    seed: int
    name: str = field(init=False, default="intensity")
    _limits: Limits = field(init=False)
    _random: np.random.Generator = field(init=False, repr=False)
    _mean_dn: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        self.reset(Limits())

    def reset(self, limits: Limits) -> None:
        """Start over with the same random numbers."""
        self._limits = limits
        self._random = np.random.default_rng(self.seed)

    def near(self, leader: Frame) -> Settings:
        """Return brighter or darker settings than those used."""
        self._mean_dn = mean_dn(leader.image)
        direction = +1 if self._mean_dn <= MIDDLE_DN else -1
        return stray(leader.used, direction, direction, self._random).clamp(self._limits)

    def diagnostics(self) -> Diagnostics:
        """Return the mean grey of the leading picture."""
        return {"leader_mean_dn": self._mean_dn}


@dataclass(slots=True)
class Unperturbed:
    """The leader's settings as they are: the control experiment."""

    name: str = field(init=False, default="none")
    _limits: Limits = field(init=False, default_factory=Limits)

    def reset(self, limits: Limits) -> None:
        """Start over."""
        self._limits = limits

    def near(self, leader: Frame) -> Settings:
        """Return the settings used."""
        return leader.used.clamp(self._limits)

    def diagnostics(self) -> Diagnostics:
        """Return nothing: nothing was changed."""
        return {}


def make_perturbation(name: str, *, seed: int) -> Perturbation:
    """Return `cycle`, `intensity` or `none`; raises UsageError for another name."""
    known = {each.name: each for each in (FourQuadrants(seed), MeanIntensity(seed), Unperturbed())}
    if name not in known:
        close = get_close_matches(name, known, 1)
        hint = f"did you mean {close[0]!r}? " if close else ""
        raise UsageError(f"unknown perturbation {name!r}; {hint}known: {', '.join(known)}")
    return known[name]


def stray(used: Settings, exposure: int, gain: int, random: np.random.Generator) -> Settings:
    """Return settings scaled by up to a half in the directions given, +1 or -1 (eq. 4.1).

    A gain of 0 dB cannot be scaled: upwards it gets a large addition, downwards a small one.
    """
    exposure_us = used.exposure_us * (1 + exposure * random.uniform(0, STRAY))
    if used.gain_db == 0:
        return Settings(exposure_us, random.uniform(*(LARGE_DB if gain > 0 else SMALL_DB)))
    return Settings(exposure_us, used.gain_db * (1 + gain * random.uniform(0, STRAY)))
