"""Cars that drive through seen drives: by a network, from anywhere, and how well they do."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from rig.core.types import THESIS_LIMITS
from rig.models.dataset import scale_settings
from rig.models.scoremap.grid import SettingsGrid
from rig.models.scoremap.network import FRAMES, ScoreMap
from rig.models.scoremap.random_exposure import RandomExposure
from rig.models.scoremap.rollout import (
    Frames,
    Journey,
    Settings2,
    Trip,
    clamped,
    lost_motions,
    matches,
    other_inliers,
    roll_out,
)
from rig.models.scoremap.seen import SeenDrive

WARM_UP_PAIRS = 10
LIGHT_POSES = 20
_START_US = (200.0, 20_000.0)
_START_DB = (0.0, 20.0)


@dataclass(frozen=True, slots=True)
class Score:
    """Matches of a journey by ground truth and expected viso2-style inliers, warm-up left out.

    `lost` is the share, 0 to 1, of pairs that told visual odometry no motion where another setting
    would have.
    """

    median: float
    min: float
    other_median: float
    other_min: float
    lost: float = 0.0

    def worth(self, front_end: str) -> float:
        """Return log median and, at 0.3 of it, log minimum, in orb, viso2 or the mean of both.

        Lost motions are viso2's.
        """
        orb, viso2 = (
            math.log(median + 1) + 0.3 * math.log(least + 20)
            for median, least in ((self.median, self.min), (self.other_median, self.other_min))
        )
        viso2 -= self.lost
        return {"orb": orb, "viso2": viso2, "both": (orb + viso2) / 2}[front_end]


@dataclass(frozen=True, slots=True)
class Chances:
    """What trips are like: how late cameras are, and how often and how far the light changes.

    A trip has one of `latencies`, each as likely. At `relit` of the trips the light changes every
    `LIGHT_POSES`: half of the time it is as it was seen, or else `darkest` to `brightest` steps of
    the grid brighter.
    """

    latencies: tuple[int, ...] = (0,)
    relit: float = 0.0
    darkest: int = -3
    brightest: int = 6

    def trip(self, drive: int, poses: int, rng: np.random.Generator) -> Trip:
        """Return a trip through a drive of so many poses."""
        latency = int(rng.choice(self.latencies))
        if rng.random() >= self.relit:
            return Trip(drive, latency)
        phase = (np.arange(poses) + rng.integers(LIGHT_POSES)) // LIGHT_POSES
        changed = rng.random(phase[-1] + 1) < 0.5
        levels = changed * rng.integers(self.darkest, self.brightest + 1, len(changed))
        return Trip(drive, latency, levels[phase])


class NetworkCars:
    """A policy for `roll_out`: N cars driven by one network, with errors of `noise` stops."""

    def __init__(
        self, network: ScoreMap, noise: float = 0.0, rng: np.random.Generator | None = None
    ) -> None:
        self._network = network.eval()
        self._noise, self._rng = noise, rng
        self._seen: list[tuple[Frames, NDArray[np.float32]]] = []
        self._asked: Settings2 | None = None

    def __call__(self, pose: int, frames: Frames, used: Settings2) -> Settings2:
        """Return the network's settings for each car."""
        self._seen = [(frames, scale_settings(used[:, 0], used[:, 1])), *self._seen][:FRAMES]
        last = self._seen + [self._seen[-1]] * (FRAMES - len(self._seen))
        images = torch.from_numpy(np.concatenate([one for one, _ in last], 1))
        asked = used if self._asked is None else self._asked
        told = [*(one for _, one in last), scale_settings(asked[:, 0], asked[:, 1])]
        settings = torch.from_numpy(np.concatenate(told, 1))
        device = next(self._network.parameters()).device
        with torch.inference_mode():
            seen = images.to(device).float() / 255
            answer = self._network(seen, settings.to(device)).cpu().numpy().astype(np.float64)
        (low, high), (low_db, high_db) = THESIS_LIMITS.exposure_us, THESIS_LIMITS.gain_db
        exposure_us = low + answer[:, 0] * (high - low)
        gain_db = low_db + answer[:, 1] * (high_db - low_db)
        if self._rng is not None and self._noise:
            exposure_us, gain_db = self._strayed(exposure_us, gain_db, self._rng)
        self._asked = clamped(np.stack([exposure_us, gain_db], axis=1))
        return self._asked

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
    drives: Sequence[SeenDrive],
    grid: SettingsGrid,
    each: int,
    chances: Chances,
    rng: np.random.Generator,
) -> list[Journey]:
    """Return `each` journeys of random behaviours through every drive.

    They steer without latency, or they would swing; that of a trip only says how long before its
    effect a command counts as given.
    """
    trips = _trips(drives, each, chances, rng)
    policy = RandomExposure(len(trips), rng)
    prompt = [replace(trip, latency=0) for trip in trips]
    journeys = roll_out(drives, grid, prompt, policy.start(), policy)
    return [replace(one, trip=trip) for one, trip in zip(journeys, trips, strict=True)]


def own_journeys(
    network: ScoreMap,
    drives: Sequence[SeenDrive],
    grid: SettingsGrid,
    each: int,
    chances: Chances,
    noise: float,
    rng: np.random.Generator,
) -> list[Journey]:
    """Return `each` journeys of the network through every drive."""
    trips = _trips(drives, each, chances, rng)
    starts = random_starts(len(trips), rng)
    return roll_out(drives, grid, trips, starts, NetworkCars(network, noise, rng))


def _trips(
    drives: Sequence[SeenDrive], each: int, chances: Chances, rng: np.random.Generator
) -> list[Trip]:
    cars = np.repeat(np.arange(len(drives)), each).tolist()
    return [chances.trip(drive, len(drives[drive].thumbnails), rng) for drive in cars]


def scores(
    policy: Callable[[int, Frames, Settings2], Settings2],
    drives: Sequence[SeenDrive],
    grid: SettingsGrid,
    latency: int = 0,
) -> list[Score]:
    """Return what a policy reaches in each drive from 1 ms and 0 dB, one car a drive."""
    if not drives:
        return []
    starts = np.tile([1_000.0, 0.0], (len(drives), 1))
    trips = [Trip(drive, latency) for drive in range(len(drives))]
    journeys = roll_out(drives, grid, trips, starts, policy)
    return [_score(drives[one.trip.drive], grid, one) for one in journeys]


def _score(drive: SeenDrive, grid: SettingsGrid, journey: Journey) -> Score:
    orb, viso2, lost = (
        count(drive, grid, journey.used, journey.trip)[WARM_UP_PAIRS - 1 :]
        for count in (matches, other_inliers, lost_motions)
    )
    return Score(
        median=float(np.median(orb)),
        min=float(orb.min()),
        other_median=float(np.median(viso2)),
        other_min=float(viso2.min()),
        lost=float(lost.mean()),
    )
