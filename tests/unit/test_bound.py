"""The bound against every path there is, on drives small enough to list them."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest

from rig.core.errors import UsageError
from rig.drivers.registry import open_source
from rig.drivers.scenes.cache import Arrays
from rig.drivers.simulated.source import SimulatedSource
from rig.experiments import bound, known_bounds
from rig.experiments.bound import (
    WARM_UP_PAIRS,
    allowed_moves,
    best_constants,
    find_bound,
    highest_median,
    highest_minimum,
    median_path,
    minimum_path,
    most_at_least,
)
from rig.experiments.known_bounds import (
    RECIPE,
    SHIPPED,
    Reach,
    known_bound,
    remember,
    scene_of,
    shipped_bounds,
)
from rig.experiments.sweeps import Counts, settings_grid

SMALL = "sim:tunnel?split=train&size=320x240"


def random_moves(seed: int, pairs: int = 5, cells: int = 4) -> Counts:
    rng = np.random.default_rng(seed)
    moves = rng.integers(0, 30, (pairs, cells, cells))
    moves[:, 0, 3] = moves[:, 3, 0] = -1
    return moves


def every_path(moves: Counts) -> list[list[int]]:
    cells = moves.shape[1]
    paths = product(range(cells), repeat=len(moves) + 1)
    counts = [
        [int(here[a, b]) for here, (a, b) in zip(moves, pairwise(path), strict=True)]
        for path in paths
    ]
    return [path for path in counts if min(path) >= 0]


@pytest.mark.parametrize("seed", range(6))
def test_no_path_does_better_and_one_does_as_well(seed: int) -> None:
    moves = random_moves(seed)
    paths = every_path(moves)
    assert highest_minimum(moves) == max(min(path) for path in paths)
    assert highest_median(moves) == max(sorted(path)[len(path) // 2] for path in paths)
    reached = max(sum(count >= 12 for count in path) for path in paths)
    assert most_at_least(moves, 12) == reached


@pytest.mark.parametrize("seed", range(6))
def test_the_paths_are_those_that_reach_the_bound_and_then_have_the_most(seed: int) -> None:
    moves = random_moves(seed)
    paths = every_path(moves)
    m, floor = highest_median(moves), highest_minimum(moves)

    def counts(path: list[int]) -> list[int]:
        return [int(here[a, b]) for here, (a, b) in zip(moves, pairwise(path), strict=True)]

    reached = counts(median_path(moves, m))
    most = max((sum(n >= m for n in path), sum(path)) for path in paths)
    assert (sum(n >= m for n in reached), sum(reached)) == most
    safe = counts(minimum_path(moves, floor))
    assert min(safe) == floor
    assert sum(safe) == max(sum(path) for path in paths if min(path) >= floor)


def test_half_of_an_even_number_of_counts_is_enough_for_the_median() -> None:
    moves = np.array([9, 1, 9, 1])[:, None, None]
    assert highest_median(moves) == 9


def test_the_constants_named_are_the_best_by_median_and_by_minimum() -> None:
    grid = settings_grid(2, 2)
    constant = np.array([[5, 7, 7, 5], [5, 9, 9, 6], [5, 1, 2, 50]])
    moves = np.full((3, 4, 4), 99)
    moves[:, np.arange(4), np.arange(4)] = constant
    best, steadiest = best_constants(moves, grid)
    assert (best.settings, best.median, best.min) == (grid.settings((1, 0)), 7.0, 2)
    assert steadiest.settings == grid.settings((1, 1))
    assert (steadiest.median, steadiest.min) == (6.0, 5)


def test_moves_are_pruned_to_neighbours_of_much_the_same_brightness() -> None:
    grid = settings_grid()
    allowed = allowed_moves(grid, Reach()).reshape(10, 5, 10, 5)
    assert set(map(tuple, np.argwhere(allowed[5, 2]))) == {
        *((row, 2) for row in range(3, 8)),
        *((row, 3) for row in range(3, 6)),
        *((row, 1) for row in range(5, 8)),
    }


def test_a_drive_has_a_bound_that_no_constant_beats_and_that_is_remembered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(known_bounds, "cache_folder", lambda: tmp_path)
    kept: dict[str, Arrays] = {}
    monkeypatch.setattr(bound, "cached", lambda _, key, make: kept.setdefault(key, make()))
    told: list[int] = []
    found = find_bound(SMALL, frames=12, processes=1, progress=lambda done, _: told.append(done))
    assert found.pairs == 2 and told == [0, 2]
    assert found.grid == (10, 5)
    assert found.best_median >= found.best_constant.median
    assert found.best_min >= found.best_constant.min
    assert 0.5 * found.best_min < found.replayed.min <= found.best_min
    assert 0.5 * found.best_median < found.replayed.median <= found.best_median
    assert known_bound(found.cameras, found.world_version) is None, "not the whole drive"
    remember(found)
    assert known_bound(found.cameras, found.world_version) == found
    assert known_bound(found.cameras, "another/1") is None
    assert known_bound(found.cameras + "&light_step=10@30", found.world_version) is None


def test_what_comes_with_the_rig_is_of_the_worlds_as_they_are() -> None:
    assert len(shipped_bounds()) >= 6
    for shipped in shipped_bounds().values():
        with closing(open_source(shipped.cameras, seed=0)) as source:
            assert isinstance(source, SimulatedSource)
            assert source.address == shipped.cameras
            assert source.world_version == shipped.world_version
            assert shipped.pairs == source.drive_triggers - 1 - (WARM_UP_PAIRS - 1)
        assert known_bound(shipped.cameras, "another/1") is None


def test_a_race_as_it_comes_is_told_how_near_the_bound_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(known_bounds, "cache_folder", lambda: tmp_path)
    with closing(open_source("sim:tunnel", seed=0)) as source:
        known = known_bound(source.address, source.world_version)
    assert known is not None
    assert 0 < known.best_min < known.best_median
    mine = replace(known, best_median=known.best_median + 1)
    remember(mine)
    assert known_bound(known.cameras, known.world_version) == mine


def test_bounds_of_another_recipe_are_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    older = SHIPPED.read_text().replace(f'"recipe": "{RECIPE}"', '"recipe": "0"')
    monkeypatch.setattr(known_bounds, "SHIPPED", tmp_path / "bounds.json")
    (tmp_path / "bounds.json").write_text(older)
    assert shipped_bounds.__wrapped__() == {}


def test_a_camera_file_that_changed_is_another_camera(tmp_path: Path) -> None:
    file = tmp_path / "camera.toml"
    file.write_text("first")
    address = f"{SMALL}&camera={file}"
    before = scene_of(address)
    file.write_text("second")
    assert scene_of(address) != before
    file.unlink()
    assert known_bound(address, "tunnel/7") is None


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"grid": (9, 4)}, "at least 10 exposures x 4 gains"),
        ({"frames": 10}, "not counted"),
        ({"processes": 0}, "number of processes"),
    ],
)
def test_a_bound_that_means_nothing_is_refused(options: dict[str, object], complaint: str) -> None:
    with pytest.raises(UsageError, match=complaint):
        find_bound(SMALL, **options)  # type: ignore[arg-type]
