"""Metrics pick one picture a place; the paths are those of the equations."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rig.experiments import target_profiles
from rig.experiments.metric_paths import (
    FRONT_END,
    LITERATURE,
    Plan,
    Seen,
    Trajectory,
    choose_paths,
    compare_plan,
    draw,
    words,
)
from rig.experiments.reproduce import Job


def test_paths_are_those_of_the_equations() -> None:
    rng = np.random.default_rng(3)
    names = ("features", "uniformity", *LITERATURE)
    scores = {name: rng.permuted(np.tile(np.arange(5.0), (4, 1)), axis=1) for name in names}
    inliers = rng.permuted(np.arange(75)).reshape(3, 5, 5)
    paths = choose_paths(Seen(scores, inliers))
    assert paths["feat"].tolist() == scores["features"].argmax(1).tolist()
    assert paths["Kim"].tolist() == scores["kim"].argmax(1).tolist()
    for place in range(3):
        assert inliers[place, :, paths["grid"][place + 1]].max() == inliers[place].max()
        followed = inliers[place, paths["seq"][place]]
        assert followed[paths["seq"][place + 1]] == followed.max()


def test_a_small_plan_gives_all_tables(tmp_path: Path) -> None:
    told: list[str] = []
    plan = Plan((Trajectory("Road", "sim:road?seed=0", 3.0, 0.1, 3),), exposures=6, size="320x240")
    job = Job(tmp_path, True, 1, told.append, lambda _done, _total: None)
    values = compare_plan(plan, job)
    assert "SIMULATED" in told[0]
    row = values["trajectories"]["Road"]
    assert set(row["paths"]) == {*FRONT_END, *LITERATURE.values()}
    grid, feat = row["paths"]["grid"], row["paths"]["feat"]
    assert grid["median"] >= feat["median"] > 100
    assert len(grid["inliers"]) == 2 and len(grid["exposure_us"]) == 3
    assert values["best"]["median"]["grid"] >= 1
    text = words(values)
    assert "Table 4.2" in text and "Table 4.4" in text and "| Road |" in text
    names = {*FRONT_END, *LITERATURE.values()}
    assert draw(values).count("<polyline") == len(names - {"grid", "seq"}) + len(names)


def test_windowed_targets_jump_less_than_those_of_the_next_pose(tmp_path: Path) -> None:
    job = Job(tmp_path, True, 1, lambda _text: None, lambda _done, _total: None)
    values = target_profiles.profiles(job)
    rows = values["profiles"]
    assert set(rows) == set(target_profiles.WAYS)
    assert target_profiles.draw(values).count("<polyline") == 2 * len(rows)
    assert rows["feat"]["jump_ev"] > rows["feat, windowed"]["jump_ev"] > 0
    mean = np.mean([rows[f"{w}, windowed"]["gain_db"] for w in ("feat", "grid")], axis=0)
    assert np.allclose(rows["hybrid, windowed"]["gain_db"], mean)
    assert "| feat, windowed |" in target_profiles.words(values)
