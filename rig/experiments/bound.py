"""What the best controller could reach on a drive, by one that knows the future.

Every setting of a grid is tried at every pose, and the inliers of every move between two settings
from one pose to the next are counted with the recipe that judges races. Moves are pruned to
neighbours: see `Reach`. A path through the drive is then chosen in hindsight, another one for each
figure, so no controller on the grid does better, and one that ties both figures need not exist.
Its steps are coarse: one that changes its settings by less can keep more where a change is dear.

Such a path knows the noise of the very pictures that it is counted on. So it is driven again in
other noise: what is left is what it owes to the future alone (`Replayed`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from rig.bulk import Workers, run_tasks
from rig.core.errors import UsageError
from rig.drivers.addresses import parse_address
from rig.drivers.registry import open_source
from rig.drivers.scenes.cache import cached
from rig.drivers.simulated.source import SimulatedSource
from rig.experiments.known_bounds import (
    Bound,
    Constant,
    Reach,
    Replayed,
    method,
    remember,
    scene_of,
)
from rig.experiments.sweeps import Bench, Counts, SettingsGrid, settings_grid

WARM_UP_PAIRS = 10
"""Pairs that are recorded but not counted."""

DB_PER_STOP = 20 * math.log10(2)

_NO_MOVE = -1
_DRAWS = 5
_PAIRS_A_PIECE = 5
_SMALLEST_GRID = (10, 4)

Progress = Callable[[int, int], None]


def find_bound(
    cameras: str,
    *,
    seed: int = 0,
    frames: int | None = None,
    grid: tuple[int, int] = (10, 5),
    processes: int | None = None,
    dask: str = "",
    progress: Progress | None = None,
) -> Bound:
    """Return the bound of the drive that `cameras` names; counts are kept in the user's cache.

    `frames` is the number of triggers, the whole drive when None; `dask` is the address of a
    scheduler to work for instead of local `processes`. Raises UsageError for cameras that are not
    simulated, fewer than 10 x 4 settings, or a drive without counted pairs.
    """
    if any(n < least for n, least in zip(grid, _SMALLEST_GRID, strict=True)):
        raise UsageError(
            f"a bound needs at least 10 exposures x 4 gains, got {grid[0]} x {grid[1]}"
        )
    source = _simulated(cameras, seed)
    triggers = frames if frames is not None else source.drive_triggers
    first = WARM_UP_PAIRS - 1  # the count of pair k is between the frames k - 1 and k
    if triggers - 1 <= first:
        raise UsageError(f"--frames {triggers}: the first {WARM_UP_PAIRS} pairs are not counted")
    work = partial(_counted, source.address, grid, Reach())
    starts = range(first, triggers - 1, _PAIRS_A_PIECE)
    pieces = [(start, min(start + _PAIRS_A_PIECE, triggers - 1)) for start in starts]
    tasks = {f"pairs {first} to {last - 1}": (first, last) for first, last in pieces}
    workers = Workers(processes, dask)
    done: dict[int, Counts] = {}
    report = progress or (lambda _done, _total: None)
    report(0, triggers - 1 - first)
    for _, (start, counts) in run_tasks(work, tasks, workers):
        done[start] = counts
        report(sum(map(len, done.values())), triggers - 1 - first)
    moves = np.concatenate([done[start] for start in starts])
    found = _bound_of(moves, settings_grid(*grid), source)
    if frames is None:
        remember(found)
    return found


def highest_minimum(moves: Counts) -> int:
    """Return the best worst count of a path; `moves` is pairs x cells x cells, -1 is no move."""
    floor = np.full(moves.shape[1], np.iinfo(np.int64).max)
    for here in moves:
        floor = np.minimum(floor[:, None], here).max(0)
    return int(floor.max())


def highest_median(moves: Counts) -> int:
    """Return the largest m that at least half of the counts of some path reach, by bisection."""
    needed = (len(moves) + 1) // 2
    low, high = 0, int(moves.max())
    while low < high:
        middle = (low + high + 1) // 2
        if most_at_least(moves, middle) >= needed:
            low = middle
        else:
            high = middle - 1
    return low


def most_at_least(moves: Counts, m: int) -> int:
    """Return the largest number of counts of at least `m` that one path has."""
    best = np.zeros(moves.shape[1])
    for here in _worths(moves, moves >= m):
        best = (best[:, None] + here).max(0)
    return int(best.max())


def median_path(moves: Counts, m: int) -> list[int]:
    """Return the cells of the path with the most counts of at least `m`, then the largest sum."""
    small = 1 / (1 + len(moves) * int(moves.max()))
    return _richest_path(_worths(moves, (moves >= m) + small * moves))


def minimum_path(moves: Counts, floor: int) -> list[int]:
    """Return the cells of the path without a count below `floor` that has the largest sum."""
    return _richest_path(np.where(moves < floor, -np.inf, moves.astype(float)))


def _worths(moves: Counts, worth: NDArray[np.generic]) -> NDArray[np.float64]:
    return np.where(moves == _NO_MOVE, -np.inf, worth.astype(float))


def _richest_path(worths: NDArray[np.float64]) -> list[int]:
    """Return the cells, one more than moves, whose moves are worth most together."""
    total, came_from = np.zeros(worths.shape[1]), []
    for here in worths:
        sums = total[:, None] + here
        came_from.append(sums.argmax(0))
        total = sums.max(0)
    path = [int(total.argmax())]
    for before in reversed(came_from):
        path.append(int(before[path[-1]]))
    return path[::-1]


def best_constants(moves: Counts, grid: SettingsGrid) -> tuple[Constant, Constant]:
    """Return the constant with the best median, and the one with the best minimum.

    Of equal ones that with the better other figure.
    """
    counts = np.diagonal(moves, axis1=1, axis2=2)
    medians, minima = np.median(counts, 0), counts.min(0)

    def last(order: NDArray[np.intp]) -> Constant:
        cell = int(order[-1])
        settings = grid.settings(divmod(cell, grid.shape[1]))
        return Constant(settings, float(medians[cell]), int(minima[cell]))

    return last(np.lexsort((minima, medians))), last(np.lexsort((medians, minima)))


def allowed_moves(grid: SettingsGrid, reach: Reach) -> NDArray[np.bool_]:
    """Return cells x cells, whether a frame may follow another with these settings."""
    exposures, gains = np.divmod(np.arange(grid.shape[0] * grid.shape[1]), grid.shape[1])
    stops = np.log2(np.array(grid.exposures_us))[exposures]
    stops += np.array(grid.gains_db)[gains] / DB_PER_STOP
    moves = [abs(values[:, None] - values) for values in (exposures, gains, stops)]
    limits = (reach.exposures, reach.gains, reach.brightness_ev)
    near = [move <= limit for move, limit in zip(moves, limits, strict=True)]
    return np.asarray(np.all(near, axis=0))


def _bound_of(moves: Counts, grid: SettingsGrid, source: SimulatedSource) -> Bound:
    best_median, best_min = highest_median(moves), highest_minimum(moves)
    paths = median_path(moves, best_median), minimum_path(moves, best_min)
    medians, minima = (_in_other_noise(source.address, grid, path) for path in paths)
    best, steadiest = best_constants(moves, grid)
    return Bound(
        cameras=source.address,
        grid=grid.shape,
        best_median=best_median,
        best_min=best_min,
        best_constant=best,
        steadiest_constant=steadiest,
        replayed=Replayed(float(np.median(medians, 1).mean()), float(minima.min(1).mean())),
        reach=Reach(),
        pairs=len(moves),
        world_version=source.world_version,
    )


def _in_other_noise(cameras: str, grid: SettingsGrid, path: Sequence[int]) -> Counts:
    """Return the inliers of a path, draws x pairs, in noise that no cell of the grid had."""
    columns, cells = grid.shape[1], math.prod(grid.shape)
    settings = [grid.settings(divmod(cell, columns)) for cell in path]
    return _bench(cameras).play(WARM_UP_PAIRS - 1, settings, range(cells, cells + _DRAWS))


def _simulated(cameras: str, seed: int) -> SimulatedSource:
    source = open_source(cameras, seed=seed, split="test")
    if not isinstance(source, SimulatedSource):
        source.close()
        raise UsageError(
            f"{cameras}: a bound needs every setting at the same pose, which only simulated "
            "cameras can give; try sim:tunnel"
        )
    if source.drive.place_s is not None:
        raise UsageError(f"{cameras}: a bound is of a drive; leave out stand=")
    return source


def _counted(
    cameras: str, shape: tuple[int, int], reach: Reach, piece: tuple[int, int]
) -> tuple[int, Counts]:
    """Return the piece's start and its moves, pairs x cells x cells, from the cache or counted."""
    first, last = piece

    def count() -> dict[str, NDArray[np.generic]]:
        bench, grid = _bench(cameras), settings_grid(*shape)
        allowed = allowed_moves(grid, reach)
        moves = [_moves(bench, pair, grid, allowed) for pair in range(first, last)]
        return {"moves": np.stack(moves).astype(np.int16)}

    key = f"{scene_of(cameras)} {_bench(cameras).version} {shape} {reach} {piece} {method()}"
    counted = cached("bounds", key, count)["moves"].astype(np.int64)
    return first, counted


def _moves(bench: Bench, pair: int, grid: SettingsGrid, allowed: NDArray[np.bool_]) -> Counts:
    before, after = bench.grid_features(pair, grid), bench.grid_features(pair + 1, grid)
    moves = np.full(allowed.shape, _NO_MOVE, np.int64)
    for a, b in np.argwhere(allowed):
        moves[a, b] = bench.inliers(before[a], after[b])
    return moves


@cache
def _bench(cameras: str) -> Bench:
    """Return the bench of an address, one a process, so that its world is opened once."""
    source = _simulated(cameras, 0)
    camera = parse_address(source.address).options["camera"]
    rate_hz = 1 / source.drive.scene_time_s(1)
    return Bench(source.scene, camera, rate_hz)
