"""The page of many runs: its numbers are evaluation.json's, and it asks nothing of the network."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from rig.evaluation.aggregate import aggregate
from rig.evaluation.report.league import ranking, verdict, write_league


def run(seed: int, left: str, a: tuple[float, int], right: str, b: tuple[float, int]) -> Any:
    def side(name: str, median: float, least: int) -> dict[str, Any]:
        orb = {"median": median, "min": least, "mean": median, "p5": least, "blind_frames": 1}
        return {"controller": name, "orb": orb}

    told = {"command": "rig race", "cameras": "sim:tunnel?x=1", "seed": seed}
    return {**told, "frames": 40, "pairs_complete": 39, "left": side(left, *a),
            "right": side(right, *b)}  # fmt: skip


def apart(runs: int, interval: list[float] | None) -> dict[str, Any]:
    told = {"difference": 60.5, "ci95": interval}
    return {"orb": {"runs": runs, "mean": told, "min": told}}


@pytest.fixture(scope="module")
def values() -> dict[str, Any]:
    runs = [
        run(1, "ours", (600, 100), "aeag", (500, 50)),
        run(2, "aeag", (450, 20), "ours", (520, 60)),
        run(3, "ours", (400, 9), "fixed:gain_db=0", (410, 0)),
    ]
    differences = {
        "ours vs aeag": apart(2, [40.0, 81.0]),
        "ours vs fixed:gain_db=0": apart(1, None),
    }
    return {**aggregate(runs), "differences": differences}


@pytest.fixture(scope="module")
def text(values: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> str:
    page = tmp_path_factory.mktemp("league") / "report.html"
    write_league(page, values)
    return page.read_text()


def test_controllers_are_ranked_with_what_they_won(values: dict[str, Any]) -> None:
    rows = [(name, score) for name, _, score in ranking(values)]
    assert rows == [("ours", (2, 1)), ("aeag", (0, 2)), ("fixed:gain_db=0", (1, 0))]


def test_the_table_is_the_evaluation(values: dict[str, Any], text: str) -> None:
    for name, told in values["by_controller"].items():
        row = re.search(rf'<tr data-controller="{name}">(.*?)</tr>', text, re.DOTALL)
        assert row is not None
        shown = dict(
            re.findall(r'data-front-end="orb" data-key="(\w+)"><data value="([^"]+)"', row[1])
        )
        assert {key: float(number) for key, number in shown.items()} == {
            key: told["orb"][key] for key in ("median", "min", "blind_frames")
        }


def test_every_run_is_a_dot_and_its_sides_are_the_controllers(text: str, tmp_path: Path) -> None:
    for label in ("seed 1: 600 and 500", "seed 2: 520 and 450", "seed 3: 400 and 410"):
        assert f"<title>{label}</title>" in text
    assert text.count('<circle class="solid left"') == 2 * 3
    swapped = [run(7, "a", (9, 1), "b", (8, 2)) | {"command": "rig race a b --swap"}]
    write_league(tmp_path / "r.html", {**aggregate(swapped),
                 "differences": {"a vs b": apart(1, None)}})  # fmt: skip
    assert "<title>seed 7 swap: 9 and 8</title>" in (tmp_path / "r.html").read_text()
    assert "SIMULATED" in text
    assert "League of 3 controllers" in text


def test_the_verdict_has_its_numbers_and_one_run_claims_nothing(values: dict[str, Any]) -> None:
    names = ("ours", "aeag")
    told = verdict(names, values["paired"]["ours vs aeag"], apart(2, [40.0, 81.0])["orb"])
    assert told.startswith("Over 2 drives ours had 1.18 times the median ORB inliers of aeag (95 %")
    assert "60 more on average (95 % +40 to +81). It won 2 and lost 0." in told
    single = values["paired"]["ours vs fixed:gain_db=0"]
    told = verdict(("ours", "fixed"), single, apart(1, None)["orb"])
    assert told.startswith("Over one drive")
    assert told.endswith("One run is one sample: it shows no significance.")
    assert "%" not in told


def test_it_asks_nothing_of_the_network_and_escapes_names(tmp_path: Path) -> None:
    hostile = "</style><img src=x onerror=alert(1)>"
    runs = [run(1, hostile, (600, 100), "aeag", (500, 50))]
    write_league(tmp_path / "r.html", {**aggregate(runs),
                 "differences": {f"{hostile} vs aeag": apart(1, None)}})  # fmt: skip
    page = (tmp_path / "r.html").read_text()
    assert hostile not in page
    assert "<img" not in page
    assert not re.search(r"https?:|//[a-z0-9-]+\.[a-z]|@import|url\(|<script", page)


def test_nothing_at_all_makes_a_page(tmp_path: Path) -> None:
    write_league(tmp_path / "r.html", {**aggregate([]), "differences": {}})
    assert "League of 0 controllers" in (tmp_path / "r.html").read_text()
