"""Differences between controllers, and that their intervals are as sure as the runs allow."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_run import SyntheticRun

from rig.core.types import Pair
from rig.evaluation.differences import differences, mean_difference, min_difference
from rig.evaluation.front_ends import parse_front_ends
from rig.evaluation.summary import summarise

Array = NDArray[np.float64]


def drive(rng: np.random.Generator, better: float, wander: float = 30.0) -> Array:
    """Return counts of two sides whose neighbours are alike: slow drift and quick noise."""
    common = np.cumsum(rng.normal(0, 8, 110)) + 400
    return np.column_stack(
        [common + better + rng.normal(0, wander, 110), common + rng.normal(0, wander, 110)]
    )


def test_the_difference_is_the_mean_over_runs() -> None:
    runs = [np.array([[5.0, 1.0], [7.0, 2.0], [6.0, 3.0]]), np.array([[1.0, 5.0], [3.0, 9.0]])]
    assert mean_difference(runs, seed=0)["difference"] == (4.0 - 5.0) / 2
    assert min_difference(runs, seed=0)["difference"] == (4.0 - 4.0) / 2


@pytest.mark.parametrize("measure", [mean_difference, min_difference])
def test_one_run_has_no_interval(measure) -> None:  # type: ignore[no-untyped-def]
    assert measure([drive(np.random.default_rng(0), 200)], seed=0)["ci95"] is None


def test_the_interval_holds_the_truth_as_often_as_it_says() -> None:
    held = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        runs = [drive(rng, 40 + rng.normal(0, 25)) for _ in range(10)]
        low, high = mean_difference(runs, seed=seed)["ci95"]
        held += low <= 40 <= high
    assert 34 <= held <= 40


def test_blocks_of_a_run_widen_what_whole_runs_alone_would_say() -> None:
    rng = np.random.default_rng(1)
    one = drive(rng, 40, wander=60.0)
    low, high = mean_difference([one] * 6, seed=0)["ci95"]
    assert low < mean_difference([one] * 6, seed=0)["difference"] < high
    assert min_difference([one] * 6, seed=0)["ci95"] == pytest.approx(
        [(one[:, 0].min() - one[:, 1].min())] * 2
    )


@pytest.mark.parametrize("seed", range(5))
def test_a_drive_half_in_the_dark_has_an_interval_around_its_difference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    light = np.repeat([800.0, 120.0, 850.0], [25, 60, 25])[:, None]
    runs = [
        light * (1.0, 0.8) * rng.uniform(0.7, 1.3) + rng.normal(0, 15, (110, 2)) for _ in range(8)
    ]
    told = mean_difference(runs, seed=seed)
    low, high = told["ci95"]
    assert low < told["difference"] < high
    assert high - low < 60


def test_the_seed_repeats_it_and_short_runs_are_taken_whole() -> None:
    rng = np.random.default_rng(2)
    runs = [drive(rng, 40)[:4] for _ in range(12)]
    assert mean_difference(runs, seed=3) == mean_difference(runs, seed=3)
    assert mean_difference(runs, seed=3) != mean_difference(runs, seed=4)


def test_both_sides_are_found_by_their_controllers_names() -> None:
    orb = parse_front_ends("orb")
    ours_left = summarise(SyntheticRun(triggers=16, seed=1), orb)
    ours_right = summarise(SyntheticRun(triggers=16, seed=2, names=Pair("aeag", "ours")), orb)
    told = differences([ours_left, ours_right])
    assert list(told) == ["ours vs aeag"]
    assert list(told["ours vs aeag"]) == ["orb"]
    orb_told = told["ours vs aeag"]["orb"]
    assert orb_told["runs"] == 2
    apart = []
    for run, own in ((ours_left, "left"), (ours_right, "right")):
        counts = {side: run.camera(side).inliers["orb"][10:] for side in ("left", "right")}
        rival = "right" if own == "left" else "left"
        apart.append(np.mean(counts[own] - counts[rival]))
    assert orb_told["mean"]["difference"] == pytest.approx(np.mean(apart))


def test_a_run_without_counts_says_nothing() -> None:
    summary = summarise(SyntheticRun(triggers=5), parse_front_ends("orb"))
    assert differences([summary]) == {}
    assert differences([]) == {}


def test_control_runs_compare_left_with_right_in_every_run() -> None:
    run = summarise(SyntheticRun(triggers=16, names=Pair("aeag", "aeag")), parse_front_ends("orb"))
    once, thrice = (differences([run] * n)["aeag vs aeag"]["orb"] for n in (1, 3))
    assert once["mean"]["difference"] != 0
    assert thrice["mean"]["difference"] == pytest.approx(once["mean"]["difference"])
