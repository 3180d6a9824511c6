"""Exposure control must matter: a fixed setting must fail somewhere, a changing one nowhere."""

from __future__ import annotations

import numpy as np
import pytest

from rig.drivers.scenes.worlds import open_world
from rig.experiments.sweeps import Bench, best_fixed, best_path, settings_grid

FRESH_SEEDS = {
    "tunnel": (13, 14, 15, 16, 17),
    "route": (21, 23, 24, 25, 26, 31, 32, 33, 34, 35),
}
"""Test worlds that were not looked at while the world families had their last changes."""
MISSES = {
    ("route", 25): pytest.mark.xfail(reason="three of five places want 0 or 30 dB", strict=True),
    ("route", 26): pytest.mark.xfail(reason="two or one, by processor", strict=False),
}
"""The worlds that are known to miss the condition; see docs/simulation.md."""
CASES = [
    pytest.param(world, seed, marks=MISSES.get((world, seed), ()))
    for world, seeds in FRESH_SEEDS.items()
    for seed in seeds
]
PLACES = {"tunnel": (12, 28, 50, 75, 105), "route": (12, 80, 150, 300, 470)}
EVERY = {"tunnel": 1, "route": 10}
"""The route is six times as long: every tenth pair of it is counted."""
BLIND = 20
FIRST = 9
"""The pair that begins at frame k is counted at frame k + 1: from 10 on."""


@pytest.mark.heavy
@pytest.mark.parametrize(("world", "seed"), CASES)
def test_exposure_control_is_needed(world: str, seed: int) -> None:
    grid = settings_grid()
    scene = open_world(world, seed=seed, split="test", width_px=640, height_px=480, speed_mps=13.9)
    bench = Bench(scene)
    around = {place + k for place in PLACES[world] for k in (-1, 0, 1)}
    counted = range(FIRST, round(10 * scene.drive_s) - 1, EVERY[world])
    maps = {pair: bench.settings_map(pair, grid) for pair in sorted({*counted, *around})}

    means = [sum(maps[p + k] for k in (-1, 0, 1)) / 3 for p in PLACES[world]]
    best_cells = [np.unravel_index(int(mean.argmax()), mean.shape) for mean in means]
    inside = [not grid.on_border((int(row), int(column))) for row, column in best_cells]
    assert sum(inside) >= 4, best_cells

    drive = np.stack(list(maps.values()))
    path = best_path(drive, reach=4)
    kept = min(inliers[cell] for inliers, cell in zip(drive, path, strict=True))
    assert kept > 200
    assert best_fixed(drive)[1] <= 0.3 * kept
    if world == "tunnel":
        assert best_fixed(drive)[1] < BLIND
