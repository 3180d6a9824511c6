"""evaluation.json: averages, ratios, and that one run never claims significance."""

from __future__ import annotations

from typing import Any

import pytest

from rig.evaluation.aggregate import aggregate


def run(left: str, a: tuple[float, int], right: str, b: tuple[float, int]) -> dict[str, Any]:
    def side(name: str, median: float | None, least: int | None) -> dict[str, Any]:
        orb = {"median": median, "min": least, "mean": median, "p5": least, "blind_frames": 1}
        return {"controller": name, "orb": orb}

    return {"left": side(left, *a), "right": side(right, *b)}


def test_averages_by_controller_over_both_sides() -> None:
    document = aggregate(
        [run("ours", (600, 100), "aeag", (500, 50)), run("aeag", (400, 30), "shin", (200, 0))]
    )
    assert document["schema"] == "rig.evaluation/1"
    assert len(document["runs"]) == 2
    assert list(document["by_controller"]) == ["ours", "aeag", "shin"]
    aeag = document["by_controller"]["aeag"]
    assert aeag["runs"] == 2
    assert aeag["orb"] == {"median": 450, "min": 40, "mean": 450, "p5": 40, "blind_frames": 1}
    assert "viso2" not in aeag


def test_a_control_run_is_one_run_of_its_controller() -> None:
    document = aggregate([run("aeag", (600, 100), "aeag", (500, 50))])
    assert document["by_controller"]["aeag"]["runs"] == 1
    assert document["by_controller"]["aeag"]["orb"]["median"] == 550
    assert list(document["paired"]) == ["aeag vs aeag"]


def test_shares_of_the_bound_are_averaged_over_the_runs_that_know_it() -> None:
    runs = [run("ours", (600, 100), "aeag", (500, 50)) for _ in range(3)]
    for told, median_pct in zip(runs, (80.0, 90.0), strict=False):
        told["left"]["of_bound"] = {"median_pct": median_pct, "min_pct": None}
    means = aggregate(runs)["by_controller"]
    assert means["ours"]["of_bound"] == {"median_pct": 85.0, "min_pct": None, "runs": 2}
    assert "of_bound" not in means["aeag"]


def test_control_runs_compare_left_with_right_in_every_run() -> None:
    runs = [run("aeag", (600, 100), "aeag", (500, 50)) for _ in range(3)]
    paired = aggregate(runs)["paired"]["aeag vs aeag"]
    assert paired["orb_median_ratio"] == pytest.approx(1.2)
    assert (paired["wins"], paired["losses"]) == (3, 0)


def test_ratio_is_of_averages_and_sides_may_change() -> None:
    document = aggregate(
        [
            run("ours", (600, 100), "aeag", (500, 50)),
            run("aeag", (400, 0), "ours", (500, 20)),
            run("ours", (300, 30), "aeag", (300, 10)),
        ]
    )
    assert list(document["paired"]) == ["ours vs aeag"]
    paired = document["paired"]["ours vs aeag"]
    assert paired["orb_median_ratio"] == pytest.approx(1400 / 1200)
    assert paired["orb_min_ratio"] == pytest.approx(150 / 60)
    assert (paired["wins"], paired["losses"]) == (2, 0)
    low, high = paired["ci95"]
    assert 1.0 <= low <= paired["orb_median_ratio"] <= high <= 1.25


def test_one_run_claims_no_significance() -> None:
    paired = aggregate([run("ours", (600, 100), "aeag", (500, 50))])["paired"]["ours vs aeag"]
    assert paired["orb_median_ratio"] == pytest.approx(1.2)
    assert paired["ci95"] is None


def test_equal_runs_have_an_interval_of_no_width_and_noise_widens_it() -> None:
    same = [run("a", (600, 1), "b", (500, 1))] * 5
    assert aggregate(same)["paired"]["a vs b"]["ci95"] == pytest.approx([1.2, 1.2])
    noisy = [run("a", (600 + 90 * i, 1), "b", (500, 1)) for i in (-2, -1, 0, 1, 2)]
    low, high = aggregate(noisy)["paired"]["a vs b"]["ci95"]
    assert low < 1.15
    assert high > 1.25


def test_bootstrap_repeats_with_its_seed() -> None:
    runs = [run("a", (600 + 91.7 * i**1.5, 1), "b", (500 - 7.3 * i, 1)) for i in range(9)]
    intervals = [aggregate(runs, seed=s)["paired"]["a vs b"]["ci95"] for s in (1, 1, 2)]
    assert intervals[0] == intervals[1]
    assert intervals[0] != intervals[2]


def test_a_blind_rival_gives_no_ratio() -> None:
    paired = aggregate([run("a", (600, 9), "b", (0, 0))] * 3)["paired"]["a vs b"]
    assert paired["orb_median_ratio"] is None
    assert paired["orb_min_ratio"] is None
    assert paired["ci95"] is None
    assert paired["wins"] == 3


def test_a_run_without_counts_is_no_duel() -> None:
    empty: Any = run("a", (None, None), "b", (None, None))  # type: ignore[arg-type]
    document = aggregate([empty])
    assert document["paired"] == {}
    assert document["by_controller"]["a"]["orb"]["median"] is None


def test_no_runs() -> None:
    assert aggregate([]) == {
        "schema": "rig.evaluation/1",
        "runs": [],
        "by_controller": {},
        "paired": {},
    }
