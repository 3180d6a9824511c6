"""Seen drives that need no rendering: one brightness is right, and light comes and goes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig.models.scoremap.grid import brightness_ev, path_grid
from rig.models.scoremap.seen import SeenDrive
from rig.models.scoremap.values import Utility, Values, denoised, move_worth, staying

GRID = path_grid(10, 4)


def make_drive(seed: int, poses: int = 40) -> SeenDrive:
    """Return a drive whose pictures are of one grey, best in the middle of its range."""
    rng = np.random.default_rng(seed)
    light_ev = 2.5 * np.sin(np.arange(poses) / rng.uniform(4, 9) + rng.uniform(0, 6))
    error_ev = brightness_ev(GRID.cells())[None] - 10 + light_ev[:, None]
    grey = 255 * np.clip(0.2 * 2.0**error_ev, 0, 1) ** (1 / 2.2)
    pictures = np.zeros((poses, len(GRID), 2, 48, 64), np.uint8)
    pictures[:, :, 0] = grey[..., None, None]
    pictures[:, :, 1] = np.where(grey > 250, 255, 0)[..., None, None]
    good = np.exp(-np.square(error_ev / 1.5))
    moves = 600 * np.minimum(good[:-1, :, None], good[1:, None, :])
    steady = 900 * np.minimum(good[:-1], good[1:])
    counts = moves.astype(np.int16), steady.astype(np.int16)
    told = counts[1] > 50
    return SeenDrive(f"sim:tunnel?seed={seed}", "synthetic/1", 0, pictures, *counts, told)


def worth_of(
    moves: NDArray[np.int16],
    steady: NDArray[np.int16],
    utility: Utility,
    told: NDArray[np.bool_] | None = None,
) -> Values:
    """Return what all moves of a drive over GRID are worth, by its counts; all told when None."""
    told = np.ones(steady.shape, np.bool_) if told is None else told
    return move_worth(utility.of(denoised(moves)), staying(steady, told), utility, GRID)
