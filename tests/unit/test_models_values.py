"""Values and paths against every path of small drives; roll-outs against the tables."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest
from synthetic_drives import GRID, make_drive, worth_of

from rig.core.errors import UsageError
from rig.models.scoremap.grid import brightness_ev, path_grid
from rig.models.scoremap.random_exposure import RandomExposure
from rig.models.scoremap.rollout import Trip, look, lost_motions, matches, other_inliers, roll_out
from rig.models.scoremap.values import (
    Staying,
    Utility,
    change_worth,
    denoised,
    kept_share,
    kept_share_at_exits,
    move_values,
)


def test_the_highest_value_is_that_of_the_best_of_all_paths() -> None:
    moves = np.random.default_rng(0).integers(0, 300, (4, 3, 3)).astype(np.int16)
    worth = Utility().of(moves.astype(np.float32))

    def total(path: tuple[int, ...]) -> float:
        return sum(0.8**t * worth[t, a, b] for t, (a, b) in enumerate(pairwise(path)))

    paths = list(product(range(3), repeat=5))
    best = max(total(path) for path in paths)
    assert move_values(worth, 0.8)[0].max() == pytest.approx(best, rel=1e-5)


def test_few_matches_cost_more_than_a_plateau_behind_them_pays() -> None:
    moves = np.full((12, 2, 2), 300, np.int16)
    moves[:, 1, 1] = 600
    moves[:, 0, 1] = 0
    forced = move_values(Utility().of(moves.astype(np.float32)), 0.95)[0]
    assert forced[0, 0] > forced[0, 1], "not through a blind move"


def test_two_poor_pairs_are_better_than_a_very_poor_one() -> None:
    moves = np.full((3, 2, 2), 300, np.int16)
    moves[:2, 0, 0] = 60
    moves[0, 0, 1] = 20
    values = move_values(Utility().of(moves.astype(np.float32)), 0.95)[0]
    assert values[0, 0] > values[0, 1]


def test_counts_are_averaged_with_their_neighbours_in_time() -> None:
    counts = np.array([[9], [0], [3], [6]], np.int16)
    assert denoised(counts)[:, 0].tolist() == [6.0, 4.0, 3.0, 5.0]


def test_the_other_front_end_bears_little_change_of_brightness() -> None:
    half, one, two = kept_share(np.array([0.5, 1.0, 2.0]))
    assert two < 0.01 < 0.2 < one < half < kept_share(np.zeros(1))[0] == 1


def test_the_poorer_end_of_a_change_says_how_many_inliers_there_were() -> None:
    utility = Utility(other_weight=1.0, other_fear=0.0, opposed_cost=0.0)
    settings, distance_ev = GRID.cells()[:2], GRID.distance_ev(GRID.cells()[:2])
    before = np.array([200.0, 100.0], np.float32)
    after = np.full(len(GRID), 150.0, np.float32)
    ends = (Staying(inliers, np.ones_like(inliers)) for inliers in (before, after))
    worth = change_worth(*ends, settings, utility, GRID)
    left = np.array([[150.0], [100.0]]) * kept_share(distance_ev)
    assert worth == pytest.approx(np.log(left + 50), abs=1e-5)


def test_what_the_other_front_end_sees_is_worth_something() -> None:
    moves = np.full((2, len(GRID), len(GRID)), 300, np.int16)
    steady = np.full(moves.shape[:2], 100, np.int16)
    steady[:, 1] = 200
    worth = worth_of(moves, steady, Utility(other_weight=0.2, other_fear=0.0))
    assert worth[0, 1, 1] - worth[0, 0, 0] == pytest.approx(0.2 * np.log(250 / 150), abs=1e-5)
    alike = worth_of(moves, steady, Utility(other_weight=0.0, other_fear=0.0))
    assert alike[0, 1, 1] == alike[0, 0, 0]


def test_few_inliers_of_the_other_front_end_are_feared() -> None:
    many, few = np.array([300.0], np.float32), np.array([5.0], np.float32)
    fearless = Utility(other_fear=0.0)
    afraid = Utility(other_fear=10.0, other_falloff=10.0)
    assert afraid.of_other(few, many) == pytest.approx(fearless.of_other(few, many), abs=1e-5)
    lost = fearless.of_other(many, few) - afraid.of_other(many, few)
    assert lost == pytest.approx(10 * np.exp(-0.5))


def test_changes_are_feared_as_they_are_at_exits() -> None:
    changes_ev = np.array([0.0, 0.5, 1.0])
    usual, at_exits = kept_share(changes_ev), kept_share_at_exits(changes_ev)
    assert usual[0] == at_exits[0] == 1
    assert (at_exits[1:] < usual[1:]).all()
    moves = np.full((2, len(GRID), len(GRID)), 300, np.int16)
    steady = np.full(moves.shape[:2], 100, np.int16)
    utility = Utility(log_weight=0.0, fear=0.0, opposed_cost=0.0, other_weight=0.0)
    worth = worth_of(moves, steady, utility)
    left = 100 * kept_share_at_exits(GRID.distance_ev(GRID.cells()))
    wanted = -utility.other_fear * np.exp(-left / utility.other_falloff)
    assert worth[0] == pytest.approx(wanted, abs=1e-4)


def test_a_pair_that_tells_no_motion_costs_what_its_utility_says() -> None:
    moves = np.full((5, len(GRID), len(GRID)), 300, np.int16)
    steady = np.full(moves.shape[:2], 300, np.int16)
    told = np.ones(steady.shape, np.bool_)
    told[:, 3] = False
    told[2, 7] = False
    free, dear = Utility(lost_cost=0.0), Utility(lost_cost=2.0)
    cost = worth_of(moves, steady, free, told) - worth_of(moves, steady, dear, told)
    assert cost[:, 3] == pytest.approx(2.0, abs=1e-4)
    assert cost[:, :, 3] == pytest.approx(2.0, abs=1e-4)
    assert cost[:, 7, 7] == pytest.approx(np.array([0, 2, 2, 2, 0]) / 3, abs=1e-4)
    assert cost[:, 0, 1] == pytest.approx(0.0, abs=1e-4)
    told[:] = False
    standing = worth_of(moves, steady, free, told) - worth_of(moves, steady, dear, told)
    assert standing == pytest.approx(2.0, abs=1e-4)


def test_a_motion_counts_as_lost_where_another_setting_tells_one() -> None:
    drive = make_drive(1)
    told = np.ones_like(drive.told)
    told[5:9, 0] = False
    told[20] = False
    drive = replace(drive, told=told)
    cells = GRID.cells()
    path = np.zeros(40, int)
    lost = lost_motions(drive, GRID, cells[path], Trip(0))
    assert np.array_equal(np.flatnonzero(lost), [5, 6, 7, 8]) and lost.max() == 1
    path[7:] = 4
    assert np.array_equal(np.flatnonzero(lost_motions(drive, GRID, cells[path], Trip(0))), [5, 6])
    between = np.tile([np.sqrt(cells[0, 0] * cells[4, 0]), 0.0], (40, 1))
    assert lost_motions(drive, GRID, between, Trip(0))[5] == pytest.approx(0.5)


def test_a_discount_of_one_is_refused() -> None:
    with pytest.raises(UsageError, match="discount"):
        Utility(discount=1.0)


def test_cells_are_found_again_and_middles_are_halves() -> None:
    grid = path_grid()
    cells = grid.cells()
    around, weights = grid.corners(cells)
    found = np.einsum("ncd,nc->nd", np.log(cells + 1)[around], weights)
    assert np.allclose(found, np.log(cells + 1))
    middle = np.array([[np.sqrt(cells[0, 0] * cells[6, 0]), cells[1, 1] / 2]])
    assert np.allclose(grid.corners(middle)[1], [0, 0.5, 0.5, 0])


def test_a_car_on_a_cell_sees_its_picture_and_gets_its_matches() -> None:
    drive = make_drive(1)
    path = np.random.default_rng(2).integers(0, len(GRID), 40)
    used = GRID.cells()[path]

    journey = roll_out(
        [drive], GRID, [Trip(0)], used[:1], lambda pose, *_: used[[min(pose + 1, 39)]]
    )
    assert np.array_equal(journey[0].frames, drive.thumbnails[np.arange(40), path])
    assert np.array_equal(journey[0].used, used)
    assert np.array_equal(
        matches(drive, GRID, used, Trip(0)), drive.moves[np.arange(39), path[:-1], path[1:]]
    )


def test_resting_between_two_cells_is_a_mixture_of_resting_on_either() -> None:
    drive = make_drive(1)
    cells = GRID.cells()
    between = np.array([np.sqrt(cells[0, 0] * cells[4, 0]), 0.0])
    resting = matches(drive, GRID, np.tile(between, (40, 1)), Trip(0))
    assert np.allclose(resting, (drive.moves[:, 0, 0] + drive.moves[:, 4, 4]) / 2.0)
    away = np.tile(between, (40, 1))
    away[1::2] = cells[4]
    moving = matches(drive, GRID, away, Trip(0))[0]
    assert moving == pytest.approx((drive.moves[0, 0, 4] + drive.moves[0, 4, 4]) / 2.0)


def test_the_other_front_end_expects_what_is_left_of_the_poorer_picture() -> None:
    drive = make_drive(1)
    cells = GRID.cells()
    path = np.zeros(40, int)
    path[20:] = 4
    expected = other_inliers(drive, GRID, cells[path], Trip(0))
    assert np.array_equal(expected[:19], drive.steady[:19, 0])
    assert np.array_equal(expected[20:], drive.steady[20:, 4])
    step_ev = np.log2(GRID.exposures_us[1] / GRID.exposures_us[0])
    poorer = min(drive.steady[19, 0], drive.steady[19, 4])
    assert expected[19] == pytest.approx(poorer * kept_share(np.array([step_ev]))[0])


def test_between_two_cells_a_picture_is_between_theirs() -> None:
    drive = make_drive(1)
    cells = GRID.cells()
    between = np.array([[np.sqrt(cells[0, 0] * cells[4, 0]), 0.0]])
    seen = look([drive], GRID, [Trip(0)], np.array([3]), between)[0].astype(float)
    low, high = drive.thumbnails[3, 0].astype(float), drive.thumbnails[3, 4].astype(float)
    assert np.abs(seen - (low + high) / 2).max() <= 0.5


def test_a_shorter_drive_ends_sooner() -> None:
    drives = [make_drive(1), make_drive(2, poses=25)]
    start = np.tile([1_000.0, 0.0], (2, 1))
    journeys = roll_out(drives, GRID, [Trip(0), Trip(1)], start, lambda _pose, _frames, used: used)
    assert [len(journey.used) for journey in journeys] == [40, 25]
    assert np.array_equal(journeys[1].frames, look_all(drives, 1, start[1]))


def look_all(drives: list[object], which: int, used: np.ndarray) -> np.ndarray:
    drive = drives[which]
    poses = range(len(drive.thumbnails))  # type: ignore[attr-defined]
    return np.stack(
        [look(drives, GRID, [Trip(which)], np.array([p]), used[None])[0] for p in poses]
    )  # type: ignore[arg-type]


def test_a_late_camera_uses_what_was_asked_for_so_many_frames_before() -> None:
    drives = [make_drive(1)]
    start = np.tile([1_000.0, 0.0], (3, 1))

    def asking(pose: int, _frames: np.ndarray, used: np.ndarray) -> np.ndarray:
        return np.stack([np.full(3, 2_000.0 + pose), np.zeros(3)], axis=1)

    trips = [Trip(0, latency) for latency in (0, 1, 2)]
    for late, journey in enumerate(roll_out(drives, GRID, trips, start, asking)):
        expected = [1_000.0] * (late + 1) + [2_000.0 + pose for pose in range(39 - late)]
        assert journey.used[:, 0].tolist() == expected


def test_brighter_light_looks_like_a_longer_exposure_then_like_more_gain() -> None:
    cells, exposures, gains = GRID.cells(), *GRID.shape
    brightness = brightness_ev(cells)
    step_ev = np.log2(GRID.exposures_us[1] / GRID.exposures_us[0])
    for steps in (-3, 0, 4):
        like = GRID.relit(steps)
        row, column = np.divmod(like, gains)
        moved = brightness[like] - brightness
        inside = (row > 0) & (row < exposures - 1)
        assert np.allclose(moved[inside], steps * step_ev)
        assert np.array_equal(column[inside], np.arange(len(GRID))[inside] % gains)
        between = (column > 0) & (column < gains - 1)
        assert np.abs(moved[between] - steps * step_ev).max() < 1.0, "half a step of gain"


def test_a_car_in_another_light_sees_and_matches_what_that_light_shows() -> None:
    drive, cell, steps = make_drive(1), 4 * 3 + 1, 2
    brighter = cell + 4 * steps
    light = np.where(np.arange(40) < 25, 0, steps)
    resting = np.tile(GRID.cells()[cell], (40, 1))
    trip = Trip(0, light=light)
    journey = roll_out([drive], GRID, [trip], resting[:1], lambda *_: resting[:1])[0]
    assert np.array_equal(journey.frames[:25], drive.thumbnails[:25, cell])
    assert np.array_equal(journey.frames[25:], drive.thumbnails[25:, brighter])
    counts = matches(drive, GRID, resting, trip)
    assert counts[24] == drive.moves[24, cell, brighter]
    assert np.array_equal(counts[25:], drive.moves[25:, brighter, brighter])


def test_moves_along_equal_brightness_cost_and_others_do_not() -> None:
    opposed = GRID.opposed_ev(GRID.cells())
    gain_ev = np.log2(10 ** (GRID.gains_db[1] / 20))
    step_ev = np.log2(GRID.exposures_us[1] / GRID.exposures_us[0])
    assert opposed[4, 1] == pytest.approx(min(gain_ev, step_ev))
    assert opposed[1, 4] == pytest.approx(opposed[4, 1])
    assert opposed[0, 4] == opposed[0, 1] == opposed[0, 5] == opposed[7, 7] == 0

    moves = np.full((6, len(GRID), len(GRID)), 300, np.int16)
    dear, free = (worth_of(moves, moves[:, 0], Utility(opposed_cost=cost)) for cost in (0.1, 0.0))
    assert dear[0, 4, 4] == free[0, 4, 4]
    assert dear[0, 4, 1] == pytest.approx(free[0, 4, 1] - 0.1 * opposed[4, 1], abs=1e-5)


def test_random_behaviours_reach_all_over_the_limits_and_repeat_with_their_seed() -> None:
    drives = [make_drive(seed) for seed in range(3)]

    def settings(seed: int) -> np.ndarray:
        policy = RandomExposure(24, np.random.default_rng(seed))
        trips = [Trip(drive) for drive in np.repeat(range(3), 8).tolist()]
        return np.concatenate(
            [one.used for one in roll_out(drives, GRID, trips, policy.start(), policy)]
        )

    used = settings(5)
    assert np.array_equal(used, settings(5))
    assert not np.array_equal(used, settings(6))
    assert used[:, 0].min() >= 75 and used[:, 0].max() <= 30_000
    assert used[:, 1].min() >= 0 and used[:, 1].max() <= 30
    assert np.ptp(np.log2(used[:, 0])) > 5 and np.ptp(used[:, 1]) > 15
