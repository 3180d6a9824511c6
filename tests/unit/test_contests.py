"""Tables of chapter 5: the figures are those of the judges, and a drive is driven once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rig.controllers.registry import NamedController, make_controller
from rig.evaluation.odometry import Step
from rig.experiments import chapter5, contests
from rig.experiments.contests import FIGURES, Contest, Duel, draw, hold, words
from rig.experiments.reproduce import ITEMS, Job
from rig.experiments.solo import Solo, run_solo
from rig.models.shipped import shipped_networks
from rig.vision.viso2.motion import Failure

BRIGHT, DARK = "fixed:exposure_us=1000,gain_db=0", "fixed:exposure_us=75,gain_db=0"
CONTEST = Contest(
    world="road",
    seeds=(31, 32),
    figures=("orb_median", "orb_min", "processed_pct"),
    methods={"bright": BRIGHT, "dark": DARK},
    compared=[
        Duel("bright", "dark", {"orb_median": (200, 300), "orb_min": (0, 5)}),
        Duel("dark", "bright"),
    ],
)
TABLES = {name: value for name, value in vars(chapter5).items() if isinstance(value, Contest)}


class Said:
    """A quick job that keeps what is said."""

    def __init__(self, folder: Path) -> None:
        self.lines: list[str] = []
        self.advanced: list[tuple[int, int]] = []
        self.job = Job(folder, True, 1, self.lines.append, lambda *at: self.advanced.append(at))


def test_figures_are_those_of_each_method_alone(tmp_path: Path) -> None:
    said = Said(tmp_path)
    values = hold(CONTEST, said.job)
    assert "SIMULATED: 2 methods on 1 drive of road/" in said.lines[0]
    assert said.advanced == [(1, 1)]
    (address,) = values["drives"]
    assert "split=test" in address and "seed=31" in address
    named = [make_controller(spec, seed=0, networks={}) for spec in (BRIGHT, DARK)]
    alone = run_solo(address, named, seed=31, frames=40)
    for solo, method in zip(alone, ("bright", "dark"), strict=True):
        row = values["methods"][method]
        (drive,) = row["by_drive"]
        assert drive == row["mean"] and set(drive) == set(FIGURES)
        for name, statistics in solo.inliers.items():
            assert drive[f"{name}_median"] == statistics.median
            assert drive[f"{name}_min"] == statistics.min
    bright, dark = (
        values["methods"][method]["mean"]["orb_median"] for method in ("bright", "dark")
    )
    assert bright > dark >= 0
    assert 0 <= values["methods"]["bright"]["mean"]["processed_pct"] <= 100
    for solo, method in zip(alone, ("bright", "dark"), strict=True):
        lost = [bool(step.failure) for step in solo.steps]  # a road has no stops
        found = values["methods"][method]["mean"]["lost_moving_pct"]
        assert found == pytest.approx(100 * sum(lost) / len(lost))
    assert values["methods"]["dark"]["mean"]["lost_moving_pct"] > 50


def test_a_wait_is_no_loss() -> None:
    def step(trigger: int, failure: Failure) -> Step:
        told = None if failure else np.eye(4)
        return Step(trigger, trigger - 1, 10, 5, failure, told)

    steps = (step(1, ""), step(2, "too little motion"), step(3, "too little motion"), step(4, ""))
    solo = Solo("any", "wall/9", {}, steps)
    way_m = np.array([0.0, 0.5, 0.0, 0.5, 0.5])
    figures = contests.figures_of(solo, way_m)
    assert figures["processed_pct"] == 50
    assert figures["lost_moving_pct"] == pytest.approx(100 / 3)


def test_a_drive_is_driven_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = hold(CONTEST, Said(tmp_path).job)

    def refused(*_: object, **__: object) -> None:
        raise AssertionError("driven again")

    monkeypatch.setattr(contests, "run_solo", refused)
    said = Said(tmp_path)
    assert hold(CONTEST, said.job) == first
    assert said.lines[0].endswith("1 of them driven before")
    others = replace(CONTEST, methods={**CONTEST.methods, "dark": BRIGHT})
    with pytest.raises(AssertionError, match="driven again"):
        hold(others, Said(tmp_path).job)


def test_a_drive_with_other_defaults_is_another(monkeypatch: pytest.MonkeyPatch) -> None:
    def changed(spec: str, *, seed: int, networks: Mapping[str, Path]) -> NamedController:
        named = make_controller(spec, seed=seed, networks=networks)
        return replace(named, options={**named.options, "speed": "0.123"})

    drive = contests.Drive("sim:road", 31, None, ("geomean",))
    before = contests._name(drive, "road/3")
    assert contests._name(drive, "road/3") == before
    monkeypatch.setattr(contests, "make_controller", changed)
    assert contests._name(drive, "road/3") != before


def test_words_tell_ratios_beside_the_published_ones() -> None:
    def row(median: float, worst: float | None) -> dict[str, float | None]:
        return dict.fromkeys(FIGURES, 1.0) | {"orb_median": median, "orb_min": worst}

    found = [
        {BRIGHT: row(300, 20), DARK: row(100, 0)},
        {BRIGHT: row(500, 40), DARK: row(300, None)},
    ]
    drives = [contests.Drive(f"sim:wall?seed={seed}", seed, 40, (BRIGHT, DARK)) for seed in (1, 2)]
    values = contests.table(CONTEST, drives, "wall/9", found)
    first, second = values["duels"]
    assert first["ratios"]["orb_median"]["ratio"] == pytest.approx(2.0)
    low, high = first["ratios"]["orb_median"]["ci95"]
    assert low <= 2.0 <= high
    assert first["ratios"]["orb_min"] == {"ratio": None, "ci95": None}
    assert second["published"] == {}
    assert "300" in draw(values) and "ORB minimum" in draw(values)
    text = words(values)
    assert "2 drives" in text and "| bright (`" + BRIGHT + "`) | 400 | 30 | 1 |" in text
    assert "; 1.50 |" in text and "rival has 0; rival had 0" in text


@pytest.mark.parametrize("name", TABLES)
def test_every_table_can_be_held(name: str) -> None:
    contest = TABLES[name]
    for spec in contest.methods.values():
        make_controller(spec, seed=0, networks=shipped_networks())
    assert set(contest.figures) <= set(FIGURES)
    for duel in contest.compared:
        assert {duel.network, duel.rival} <= set(contest.methods)
        assert set(duel.published) <= set(contest.figures)
    assert name.lower().replace("_", "-", 1).replace("_", ".") in ITEMS
