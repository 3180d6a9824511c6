"""Exposure control must matter: no fixed setting may survive a test drive, a path of them must."""

from __future__ import annotations

import numpy as np
import pytest

from rig.drivers.scenes.worlds import open_world
from rig.experiments.sweeps import Bench, best_fixed, best_path, settings_grid

FRESH_SEEDS = (5, 6, 7)
"""Test worlds that nobody looked at while the world family was made."""
PLACES = (12, 28, 50, 75, 105)
SAMPLED = range(10, 119, 4)
BLIND = 20


@pytest.mark.heavy
@pytest.mark.parametrize("seed", FRESH_SEEDS)
def test_the_tunnel_needs_exposure_control(seed: int) -> None:
    grid = settings_grid()
    scene = open_world(
        "tunnel", seed=seed, split="test", width_px=640, height_px=480, speed_mps=13.9
    )
    bench = Bench(scene)
    pairs = sorted({*SAMPLED, *(place + step for place in PLACES for step in (-1, 0, 1))})
    maps = {pair: bench.settings_map(pair, grid) for pair in pairs}

    means = [np.mean([maps[place + step] for step in (-1, 0, 1)], axis=0) for place in PLACES]
    best_cells = [np.unravel_index(int(mean.argmax()), mean.shape) for mean in means]
    inside = [not grid.on_border((int(row), int(column))) for row, column in best_cells]
    assert sum(inside) >= 4, best_cells

    drive = np.stack([maps[pair] for pair in pairs])
    assert best_fixed(drive)[1] < BLIND
    path = best_path(drive, reach=4)
    assert min(inliers[cell] for inliers, cell in zip(drive, path, strict=True)) > 200
