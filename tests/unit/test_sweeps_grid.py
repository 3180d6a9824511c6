from __future__ import annotations

from itertools import pairwise

import numpy as np

from rig.core.types import Limits, Settings
from rig.experiments.sweeps import Bench, best_fixed, best_path, settings_grid


def test_the_grid_spans_the_limits() -> None:
    grid = settings_grid(3, 2, Limits((100.0, 10_000.0), (0.0, 30.0)))
    assert grid.shape == (3, 2)
    assert np.allclose(grid.exposures_us, (100, 1_000, 10_000))
    assert grid.settings((2, 1)).gain_db == 30.0


def test_the_border_is_the_outer_ring() -> None:
    grid = settings_grid(4, 3)
    inner = [(i, j) for i in range(4) for j in range(3) if not grid.on_border((i, j))]
    assert inner == [(1, 1), (2, 1)]


def test_the_best_fixed_setting_has_the_best_worst_pair() -> None:
    maps = np.array([[[9, 5], [0, 1]], [[1, 4], [9, 1]]])
    assert best_fixed(maps) == ((0, 1), 4)


def test_the_best_path_keeps_the_floor_high_before_it_sums() -> None:
    maps = np.array([[[9, 5, 0]], [[0, 5, 9]], [[0, 4, 9]]])
    assert best_path(maps) == [(0, 0), (0, 1), (0, 2)]


def test_the_best_path_moves_no_further_than_it_may() -> None:
    maps = np.array([[[9, 1, 1]], [[1, 1, 9]]])
    path = best_path(maps)
    assert all(abs(a[1] - b[1]) <= 1 for a, b in pairwise(path))


def test_a_played_path_counts_the_inliers_between_its_frames() -> None:
    from rig.drivers.scenes.worlds import open_world

    scene = open_world("tunnel", seed=0, split="test", width_px=320, height_px=240, speed_mps=13.9)
    bench = Bench(scene)
    day, night = Settings(500.0, 7.5), Settings(75.0, 0.0)
    (seen,) = bench.play(100, [day, day, night])
    assert seen[0] > 100
    assert seen[1] < 20
    again, other = bench.play(100, [day, day, night], noises=(0, 50))
    assert list(again) == list(seen)
    assert other[0] != seen[0]
    assert abs(other[0] - seen[0]) < 0.3 * seen[0]
