"""The sweep of rivals: alone as in a race, resumed where it stopped, scored as it says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from rig.controllers.registry import make_controller
from rig.core.errors import RigError, UsageError
from rig.core.types import Settings
from rig.evaluation.statistics import InlierStatistics
from rig.experiments import tuning
from rig.experiments.reproduce import ITEMS, Job, find_item
from rig.experiments.rivals import CONSTANTS, QUICK, RIVALS
from rig.experiments.searches import frames_to_converge
from rig.experiments.solo import Solo
from rig.experiments.tuning import FULL, Plan, Race, table, tune_plan, words

PLAN = Plan(
    rivals={"mean": ("mean:speed=1", "mean:speed=0.5")},
    constants=("fixed:gain_db=0", "fixed:gain_db=9"),
    heats={"tunnel": (0, 1)},
    size="320x240",
    frames=12,
)
MEDIANS = {
    "mean:speed=1": 400,
    "mean:speed=0.5": 300,
    "fixed:gain_db=0": 100,
    "fixed:gain_db=9": 200,
}


class Said:
    """Plays the terminal and the processes; counts what was driven."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.lines, self.driven = folder, [], []
        monkeypatch.setattr(tuning, "run_solo", self._solo)
        monkeypatch.setattr(tuning, "_world_version", lambda world, seed: self.version)
        self.version = "tunnel/9"
        self.medians = MEDIANS

    def _solo(self, address, controllers, *, seed, frames, front_ends):  # type: ignore[no-untyped-def]
        assert "split=train" in address
        self.driven += [(controller.name, seed) for controller in controllers]
        assert set(front_ends) == {"orb"}
        return [
            Solo(c.name, self.version, {"orb": self._orb(c.name, 10 * seed)}) for c in controllers
        ]

    def _orb(self, name: str, worst: int) -> InlierStatistics:
        return InlierStatistics(self.medians[name], worst, None, None, 1)

    def job(self) -> Job:
        return Job(self.folder, False, 1, self.lines.append, lambda done, total: None)


@pytest.fixture
def said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Said:
    return Said(tmp_path, monkeypatch)


def race(controller: str, seed: int, median: float, worst: int) -> Race:
    return Race(controller, "tunnel", seed, "320x240", 12, "tunnel/9", median, worst, 0)


def test_the_score_weighs_median_and_minimum_alike() -> None:
    races = [
        race("fixed:gain_db=0", 0, 100, 20),
        race("fixed:gain_db=9", 0, 200, 0),
        race("fixed:gain_db=0", 1, 100, 0),
        race("fixed:gain_db=9", 1, 50, 0),
        race("mean:speed=1", 0, 400, 60),
        race("mean:speed=1", 1, 100, 60),
        race("mean:speed=0.5", 0, 100, 20),
        race("mean:speed=0.5", 1, 25, 0),
    ]
    values = table(PLAN, {each.key: each for each in races})
    assert [drive["reference"] for drive in values["drives"]] == ["fixed:gain_db=0"] * 2
    scores = {row["controller"]: row["score"] for row in values["rivals"]["mean"]}
    first, second = (4 * 80 / 40) ** 0.5, (1 * 80 / 20) ** 0.5
    assert scores["mean:speed=1"] == pytest.approx((first * second) ** 0.5)
    assert scores["mean:speed=0.5"] == pytest.approx((1 * 0.5) ** 0.5)
    assert values["best"]["mean"] == "mean:speed=1"
    assert "**`mean:speed=1`**" in words(values)


def test_a_sweep_goes_on_where_it_stopped(said: Said) -> None:
    once = tune_plan(PLAN, said.job())
    assert sorted(said.driven) == sorted((spec, seed) for spec in PLAN.variants for seed in (0, 1))
    path = said.folder / "rival-tuning.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    assert len(lines) == 8
    path.write_text("".join(lines[:5]) + lines[5][:20])
    said.driven.clear()
    assert tune_plan(PLAN, said.job()) == once
    assert len(said.driven) == 3
    assert any("5 done, 3 left" in line for line in said.lines)


def test_races_of_other_defaults_are_driven_again(said: Said) -> None:
    tune_plan(PLAN, said.job())
    path = said.folder / "rival-tuning.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    changed = [row for row in rows if row["controller"] == "mean:speed=1"]
    for row in changed:
        row["options"]["percent"] = "41"
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    said.driven.clear()
    tune_plan(PLAN, said.job())
    assert len(said.driven) == len(changed) == 2


def test_only_the_best_of_the_heats_drive_the_finals(said: Said) -> None:
    plan = replace(PLAN, heats={"tunnel": (0,)}, finals={"tunnel": (1, 2)}, finalists=1)
    values = tune_plan(plan, said.job())
    finalists = {spec for spec, seed in said.driven if seed > 0}
    assert finalists == {"mean:speed=1", "fixed:gain_db=9"}
    first, second = values["rivals"]["mean"]
    assert (first["controller"], second["controller"]) == ("mean:speed=1", "mean:speed=0.5")
    assert second["score"] is None
    assert first["heats"] == pytest.approx(2**0.5)
    assert first["score"] == pytest.approx(2**0.5)
    assert [drive["stage"] for drive in values["drives"]] == ["heat", "final", "final"]
    said.driven.clear()
    assert tune_plan(plan, said.job()) == values
    assert said.driven == []


def test_results_of_another_world_are_not_used(said: Said) -> None:
    tune_plan(PLAN, said.job())
    said.driven.clear()
    said.version = "tunnel/10"
    tune_plan(PLAN, said.job())
    assert len(said.driven) == 8


def test_what_cannot_be_swept_is_one_line(said: Said) -> None:
    with pytest.raises(UsageError, match="needs the world 'moon'; this version has: tunnel"):
        tune_plan(replace(PLAN, heats={"moon": (0,)}), said.job())
    (said.folder / "rival-tuning.jsonl").write_text(json.dumps({"controller": "x"}) + "\n")
    with pytest.raises(RigError, match=r"rival-tuning\.jsonl: line 1 is no result"):
        tune_plan(PLAN, said.job())


def test_only_training_worlds_are_swept_and_every_variant_is_a_controller() -> None:
    assert set(FULL.heats) == set(FULL.finals) == {"tunnel", "road"}
    for world, seeds in FULL.heats.items():
        assert not set(seeds) & set(FULL.finals[world])
    specs = [*CONSTANTS, *(s for rows in (RIVALS, QUICK) for row in rows.values() for s in row)]
    for spec in specs:
        assert make_controller(spec, seed=0, networks={}).name == spec


def test_items_are_found_by_name() -> None:
    for name in ITEMS:
        assert find_item(name) is ITEMS[name]
    with pytest.raises(UsageError, match="no experiment is called 'rival-tune'; did you mean"):
        find_item("rival-tune")


@pytest.mark.parametrize(
    ("exposures", "frames"),
    [
        ([100.0] * 40, 0),
        ([100.0] * 30 + [200.0] * 3 + [400.0] * 20, 3),
        ([100.0] * 30 + [400.0] * 20, 0),
        ([100.0] * 30 + [100.0 * 1.5**k for k in range(20)], None),
        ([100.0] * 30 + [330.0, 400.0, 800.0] + [400.0] * 20, 3),
    ],
)
def test_convergence_is_when_brightness_stays(exposures: list[float], frames: int | None) -> None:
    assert frames_to_converge(tuple(Settings(e, 0.0) for e in exposures), 30) == frames
