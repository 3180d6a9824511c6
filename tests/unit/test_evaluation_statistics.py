"""What is counted, and the arithmetic, against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from rig.evaluation.statistics import counted, inlier_statistics, interval95, latency, spread


def test_triggers_below_ten_are_warm_up() -> None:
    trigger = np.arange(13)
    assert counted(trigger, trigger * 100.0).tolist() == [1000.0, 1100.0, 1200.0]


def test_warm_up_goes_by_trigger_not_by_row() -> None:
    assert counted(np.array([8, 9, 40]), np.array([1.0, 2.0, 3.0])).tolist() == [3.0]


def test_what_does_not_exist_is_not_counted_as_zero() -> None:
    assert counted(np.arange(10, 13), np.array([5.0, np.nan, 0.0])).tolist() == [5.0, 0.0]


def test_statistics_by_hand() -> None:
    statistics = inlier_statistics(np.array([100.0, 19.0, 20.0, 0.0, 61.0]), blind_below=20)
    assert statistics.median == 20.0
    assert statistics.min == 0
    assert statistics.mean == 40.0
    assert statistics.p5 == pytest.approx(0.2 * 19.0)
    assert statistics.blind_frames == 2


def test_nothing_counted_is_none_not_zero() -> None:
    statistics = inlier_statistics(np.array([]), blind_below=20)
    assert (statistics.median, statistics.min, statistics.mean, statistics.p5) == (None,) * 4
    assert spread(np.array([])) == (None, None, None)
    assert latency(np.array([])) == {"p50": None, "p99": None}


def test_spread_and_latency() -> None:
    assert spread(np.array([3.0, 1.0, 2.0, 9.0])) == (1.0, 2.5, 9.0)
    values = latency(np.arange(101.0))
    assert values == {"p50": 50.0, "p99": 99.0}


def test_an_interval_from_few_runs_is_wider_than_its_draws_say() -> None:
    draws = np.linspace(-1, 1, 100_001)
    wide, narrow = (interval95(draws, runs)[1] for runs in (5, 1_000))
    assert narrow == pytest.approx(0.95, abs=0.002)
    # Student's quantile of 4 degrees of freedom is 2.776; the normal share above 3.104 is 0.00096.
    assert wide == pytest.approx(1 - 2 * 0.00096, abs=2e-5)
    assert interval95(draws, 2) == pytest.approx([-1, 1])
