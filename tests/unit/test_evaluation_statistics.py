"""What is counted, and the arithmetic, against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from rig.evaluation.statistics import counted, inlier_statistics, latency, spread


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
