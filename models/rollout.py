"""Driving through seen drives: controllers in closed loop without rendering anything anew.

A picture of settings between the cells of the grid is interpolated from its four neighbours, and
so is the number of matches of a move.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.types import THESIS_LIMITS, Limits
from rig.models.grid import SettingsGrid
from rig.models.seen import SeenDrive

Settings2 = NDArray[np.float64]
"""N x (exposure_us, gain_db)."""

Frames = NDArray[np.uint8]
"""N x 2 x 48 x 64 thumbnails."""

Policy = Callable[[int, Frames, Settings2], Settings2]
"""Told the pose, the pictures of all cars and the settings they used; returns the next ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Journey:
    """One car's way through drive number `drive`: P pictures and the settings of each."""

    drive: int
    frames: Frames
    used: Settings2


def roll_out(
    drives: Sequence[SeenDrive],
    grid: SettingsGrid,
    cars: Sequence[int],
    start: Settings2,
    policy: Policy,
) -> list[Journey]:
    """Drive one car through drive `cars[i]` from `start[i]`; all move at once, pose by pose.

    A shorter drive ends sooner; its car stands at the end until the longest is over.
    """
    lengths = np.array([len(drives[car].thumbnails) for car in cars])
    frames = [np.empty((n, *drives[0].thumbnails.shape[2:]), np.uint8) for n in lengths]
    used = [np.empty((n, 2)) for n in lengths]
    settings = np.array(start, np.float64)
    for pose in range(int(lengths.max())):
        at = np.minimum(pose, lengths - 1)
        seen = look(drives, grid, cars, at, settings)
        for car, index in enumerate(at):
            if pose == index:
                frames[car][pose], used[car][pose] = seen[car], settings[car]
        settings = clamped(policy(pose, seen, settings))
    return [Journey(*one) for one in zip(cars, frames, used, strict=True)]


def look(
    drives: Sequence[SeenDrive],
    grid: SettingsGrid,
    cars: Sequence[int],
    poses: NDArray[np.int64],
    settings: Settings2,
) -> Frames:
    """Return what each car sees at its pose with its settings."""
    cells, weights = grid.corners(settings)
    seen = np.empty((len(cars), *drives[0].thumbnails.shape[2:]), np.uint8)
    for car, (drive, pose) in enumerate(zip(cars, poses, strict=True)):
        corners = drives[drive].thumbnails[pose, cells[car]].astype(np.float32)
        seen[car] = np.rint(np.tensordot(weights[car].astype(np.float32), corners, 1))
    return seen


def matches(drive: SeenDrive, grid: SettingsGrid, used: Settings2) -> NDArray[np.float64]:
    """Return the P-1 counts between consecutive pictures of a journey with these settings.

    Between cells a move is a mixture of moves between cells in which both ends shift together as
    far as they can: resting between two cells is a mixture of resting on either.
    """
    cells, weights = grid.corners(used)
    between = drive.moves[
        np.arange(len(used) - 1)[:, None, None], cells[:-1, :, None], cells[1:, None, :]
    ]
    return np.asarray((between * _together(weights[:-1], weights[1:])).sum((1, 2)))


def _together(before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return N x 4 x 4 weights with these sums, as much of each on the diagonal as can be."""
    both = np.minimum(before, after)
    apart = (before - both)[:, :, None] * (after - both)[:, None, :]
    left = np.maximum(1 - both.sum(1), np.finfo(float).tiny)[:, None, None]
    return np.asarray(apart / left + both[:, :, None] * np.eye(4))


def clamped(settings: Settings2, limits: Limits = THESIS_LIMITS) -> Settings2:
    """Return the nearest settings inside the limits."""
    exposures = np.clip(settings[:, 0], *limits.exposure_us)
    return np.stack([exposures, np.clip(settings[:, 1], *limits.gain_db)], axis=1)
