"""Cars that expose in all sorts of ways, well and badly: what a network should have seen.

Each follows a mean-intensity law whose speed, target and shutter cap change every dozen frames,
with a wandering error, sudden jumps, and an unusual split between exposure and gain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig.models.scoremap.rollout import Frames, Settings2, clamped

GAMMA = 2.2
PHASE_FRAMES = 12
JUMP_PROBABILITY = 0.06
JUMP_EV = 3.0
WANDER_KEPT = 0.75
WANDER_EV = 0.35
SPLIT_EV = 0.2
SPLIT_DB = 1.0
_EV_PER_DB = 1 / (20 * np.log10(2))
_LONGEST_EV, _SHORTEST_EV = np.log2(30_000), np.log2(75)
_MOST_GAIN_EV = 30 * _EV_PER_DB


class RandomExposure:
    """A policy for `roll_out`: N cars, all decisions drawn from one seed."""

    def __init__(self, cars: int, rng: np.random.Generator) -> None:
        self._rng = rng
        self._cars = cars
        self._wander_ev = np.zeros(cars)
        self._law_ev = rng.uniform(_SHORTEST_EV + 1, _LONGEST_EV + 1, cars)
        self._new_phase(np.ones(cars, bool))
        self._phase = rng.integers(0, PHASE_FRAMES, cars)

    def start(self) -> Settings2:
        """Return the first settings of each car."""
        return self._split(self._law_ev)

    def __call__(self, pose: int, frames: Frames, used: Settings2) -> Settings2:
        """Return the next settings of each car."""
        light = np.square(frames[:, 0].astype(np.float32) / 255) ** (GAMMA / 2)
        mean = np.maximum(light.mean((1, 2)), 2e-3)
        now_ev = np.log2(used[:, 0]) + used[:, 1] * _EV_PER_DB - self._wander_ev
        correction = np.clip(np.log2(self._target / mean) + self._wander_ev, -4, 4)
        self._law_ev = now_ev + self._speed * correction
        self._law_ev = np.clip(self._law_ev, _SHORTEST_EV, _LONGEST_EV + _MOST_GAIN_EV)
        self._new_phase((pose + self._phase) % PHASE_FRAMES == 0)
        self._stray()
        return self._split(self._law_ev + self._wander_ev)

    def _new_phase(self, begins: NDArray[np.bool_]) -> None:
        n, rng = self._cars, self._rng
        speed = rng.choice([0.2, 0.35, 0.6, 0.9, 1.0], n)
        target = np.exp(rng.uniform(np.log(0.04), np.log(0.5), n))
        cap_ev = rng.uniform(np.log2(2_000), _LONGEST_EV, n)
        if begins.all():
            self._speed, self._target, self._cap_ev = speed, target, cap_ev
        self._speed = np.where(begins, speed, self._speed)
        self._target = np.where(begins, target, self._target)
        self._cap_ev = np.where(begins, cap_ev, self._cap_ev)

    def _stray(self) -> None:
        n, rng = self._cars, self._rng
        self._wander_ev = WANDER_KEPT * self._wander_ev + rng.normal(0, WANDER_EV, n)
        jumps = rng.random(n) < JUMP_PROBABILITY
        self._wander_ev = np.where(jumps, rng.uniform(-JUMP_EV, JUMP_EV, n), self._wander_ev)

    def _split(self, brightness_ev: NDArray[np.float64]) -> Settings2:
        """Exposure up to the cap, then gain, then exposure again; and not quite like that."""
        exposure_ev = np.clip(brightness_ev, _SHORTEST_EV, self._cap_ev)
        gain_ev = np.clip(brightness_ev - exposure_ev, 0, _MOST_GAIN_EV)
        exposure_ev = brightness_ev - gain_ev
        moved = self._rng.normal(0, SPLIT_EV, self._cars)
        gain_db = (gain_ev - moved) / _EV_PER_DB + self._rng.normal(0, SPLIT_DB, self._cars)
        return clamped(np.stack([np.exp2(exposure_ev + moved), gain_db], axis=1))
