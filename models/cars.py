"""Cars that drive through seen drives: by a network, from anywhere, and how well they do."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from rig.core.types import THESIS_LIMITS
from rig.models.behaviour import RandomExposure
from rig.models.dataset import scale_settings
from rig.models.grid import SettingsGrid
from rig.models.rollout import Frames, Journey, Settings2, matches, roll_out
from rig.models.scoremap import FRAMES, ScoreMap
from rig.models.seen import SeenDrive

WARM_UP_PAIRS = 10
_START_US = (200.0, 20_000.0)
_START_DB = (0.0, 20.0)


@dataclass(frozen=True, slots=True)
class Score:
    """Matches of a journey by ground truth, warm-up left out."""

    median: float
    min: float


class NetworkCars:
    """A policy for `roll_out`: N cars driven by one network, with errors of `noise` stops."""

    def __init__(
        self, network: ScoreMap, noise: float = 0.0, rng: np.random.Generator | None = None
    ) -> None:
        self._network = network.eval()
        self._noise, self._rng = noise, rng
        self._seen: list[tuple[Frames, NDArray[np.float32]]] = []

    def __call__(self, pose: int, frames: Frames, used: Settings2) -> Settings2:
        """Return the network's settings for each car."""
        self._seen = [(frames, scale_settings(used[:, 0], used[:, 1])), *self._seen][:FRAMES]
        last = self._seen + [self._seen[-1]] * (FRAMES - len(self._seen))
        images = torch.from_numpy(np.concatenate([one for one, _ in last], 1))
        settings = torch.from_numpy(np.concatenate([one for _, one in last], 1))
        device = next(self._network.parameters()).device
        with torch.inference_mode():
            seen = images.to(device).float() / 255
            answer = self._network(seen, settings.to(device)).cpu().numpy().astype(np.float64)
        (low, high), (low_db, high_db) = THESIS_LIMITS.exposure_us, THESIS_LIMITS.gain_db
        exposure_us = low + answer[:, 0] * (high - low)
        gain_db = low_db + answer[:, 1] * (high_db - low_db)
        if self._rng is not None and self._noise:
            exposure_us, gain_db = self._strayed(exposure_us, gain_db, self._rng)
        return np.stack([exposure_us, gain_db], axis=1)

    def _strayed(
        self,
        exposure_us: NDArray[np.float64],
        gain_db: NDArray[np.float64],
        rng: np.random.Generator,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        n = len(gain_db)
        jumps = rng.random(n) < 0.05
        ev = np.where(jumps, rng.uniform(-3, 3, n), rng.normal(0, self._noise, n))
        return exposure_us * np.exp2(ev), gain_db + rng.normal(0, 6 * self._noise, n)


def random_starts(cars: int, rng: np.random.Generator) -> Settings2:
    """Return first settings from all over the grid."""
    exposure_us = np.exp(rng.uniform(math.log(_START_US[0]), math.log(_START_US[1]), cars))
    gain_db = np.where(rng.random(cars) < 0.5, 0.0, rng.uniform(*_START_DB, cars))
    return np.stack([exposure_us, gain_db], axis=1)


def random_journeys(
    drives: Sequence[SeenDrive], grid: SettingsGrid, each: int, rng: np.random.Generator
) -> list[Journey]:
    """Return `each` journeys of random behaviours through every drive."""
    cars = np.repeat(np.arange(len(drives)), each).tolist()
    policy = RandomExposure(len(cars), rng)
    return roll_out(drives, grid, cars, policy.start(), policy)


def own_journeys(
    network: ScoreMap,
    drives: Sequence[SeenDrive],
    grid: SettingsGrid,
    each: int,
    noise: float,
    rng: np.random.Generator,
) -> list[Journey]:
    """Return `each` journeys of the network through every drive."""
    cars = np.repeat(np.arange(len(drives)), each).tolist()
    starts = random_starts(len(cars), rng)
    return roll_out(drives, grid, cars, starts, NetworkCars(network, noise, rng))


def scores(
    policy: Callable[[int, Frames, Settings2], Settings2],
    drives: Sequence[SeenDrive],
    grid: SettingsGrid,
) -> list[Score]:
    """Return what a policy reaches in each drive from 1 ms and 0 dB, one car a drive."""
    if not drives:
        return []
    starts = np.tile([1_000.0, 0.0], (len(drives), 1))
    journeys = roll_out(drives, grid, range(len(drives)), starts, policy)
    counts = [matches(drives[j.drive], grid, j.used)[WARM_UP_PAIRS - 1 :] for j in journeys]
    return [Score(float(np.median(one)), float(one.min())) for one in counts]
