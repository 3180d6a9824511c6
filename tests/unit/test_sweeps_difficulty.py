"""Exposure control must matter: a fixed setting must fail somewhere, a changing one nowhere."""

from __future__ import annotations

import numpy as np
import pytest

from rig.drivers.scenes.worlds import open_world
from rig.experiments.sweeps import Bench, best_fixed, best_path, settings_grid

FRESH_SEEDS = (5, 6, 7)
"""Test worlds that were not looked at while the world family was made."""
PLACES = (12, 28, 50, 75, 105)
COUNTED = range(9, 119)
"""The pair that begins at frame k is counted at frame k + 1: 10 to 119."""
BLIND = 20


@pytest.mark.heavy
@pytest.mark.parametrize("seed", FRESH_SEEDS)
def test_the_tunnel_needs_exposure_control(seed: int) -> None:
    grid = settings_grid()
    scene = open_world(
        "tunnel", seed=seed, split="test", width_px=640, height_px=480, speed_mps=13.9
    )
    bench = Bench(scene)
    drive = np.stack([bench.settings_map(pair, grid) for pair in COUNTED])

    around = [slice(place - 1 - COUNTED.start, place + 2 - COUNTED.start) for place in PLACES]
    means = [drive[pairs].mean(0) for pairs in around]
    best_cells = [np.unravel_index(int(mean.argmax()), mean.shape) for mean in means]
    inside = [not grid.on_border((int(row), int(column))) for row, column in best_cells]
    assert sum(inside) >= 4, best_cells

    path = best_path(drive, reach=4)
    assert min(inliers[cell] for inliers, cell in zip(drive, path, strict=True)) > 200
    assert best_fixed(drive)[1] < BLIND
