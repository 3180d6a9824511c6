"""The report: its numbers are the summary's, it asks nothing of the network, names are escaped."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import SyntheticRun

from rig.core.types import Pair
from rig.evaluation.odometry import Odometry, Step, Trajectory
from rig.evaluation.report import write_report
from rig.evaluation.report.curves import curves
from rig.evaluation.report.internals import spoken
from rig.evaluation.report.page import render
from rig.evaluation.report.tiles import tiles
from rig.evaluation.report.verdict import verdict
from rig.evaluation.report.ways import ways
from rig.evaluation.report.wording import labels, number, significant
from rig.evaluation.summary import Summary, summarise


def page(run: SyntheticRun) -> str:
    return render(run, summarise(run))


class Tags(HTMLParser):
    """Collects every start tag with its attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))


@pytest.fixture(scope="module")
def run() -> SyntheticRun:
    return SyntheticRun(triggers=40, lost={20: "timeout", 30: "sequence"})


@pytest.fixture(scope="module")
def summary(run: SyntheticRun) -> Summary:
    return summarise(run)


@pytest.fixture(scope="module")
def text(run: SyntheticRun, summary: Summary) -> str:
    return render(run, summary)


def test_it_asks_nothing_of_the_network(text: str) -> None:
    assert not re.search(r"https?:|//[a-z0-9-]+\.[a-z]|@import|url\(", text)
    for tag, attributes in Tags(text).tags:
        for name in ("src", "href"):
            assert (attributes.get(name) or "data:").startswith("data:"), (tag, attributes)


def test_the_curves_are_the_series(summary: Summary, text: str) -> None:
    found = re.search(r'<script type="application/json" id="series">(.*?)</script>', text)
    assert found is not None
    drawn = json.loads(found.group(1))
    assert drawn["pair"] == list(range(40))
    assert drawn["incomplete"] == [20, 30]
    titles = [chart["title"] for chart in drawn["charts"]]
    assert titles[:3] == ["ORB inliers", "viso2-style inliers", "Exposure"]
    left, right = drawn["charts"][0]["curves"]
    counts = summary.camera("left").inliers["orb"]
    assert left["values"] == [None if c != c else c for c in counts.tolist()]
    assert (left["name"], right["name"]) == ("ours", "aeag")
    assert drawn["charts"][2]["log"] is True


def test_the_parts_of_the_drive_are_shaded_and_have_their_own_rows(
    summary: Summary, text: str
) -> None:
    assert [(part.kind, part.first, part.last) for part in summary.segments] == [
        ("static", 0, 15),
        ("inside", 16, 29),
        ("static", 30, 39),
    ]
    drawn = curves(summary)["segments"]
    assert drawn[1] == {"kind": "inside", "first": 16, "last": 29}
    assert 'data-segment="inside"' in text
    assert 'data-segment="static"' in text


def test_the_tiles_compare_at_a_glance(summary: Summary) -> None:
    shown = tiles(summary)
    assert len(shown) == 4
    median, blind = shown[0], shown[2]
    assert max(bar.length_pct for bar in median.bars) == 100
    assert blind.bars[0].text == str(summary.left.inliers["orb"].blind_frames)
    assert tiles(summarise(SyntheticRun(triggers=3))) == []


def test_what_controllers_say_is_drawn_and_counted(summary: Summary, text: str) -> None:
    internal = [c for c in curves(summary)["charts"] if c["host"] == "internal-charts"]
    assert [(c["title"], c["curves"][0]["side"]) for c in internal] == [
        ("answer", "left"),
        ("answer", "right"),
    ]
    assert internal[1]["curves"][0]["values"][11] == 2.1
    assert internal[1]["curves"][0]["values"][20] is None
    words = spoken(summary)
    assert [(said.side, said.about) for said in words] == [("left", "phase"), ("right", "phase")]
    assert dict(words[0].counts) == {"hold": 15, "search": 13}
    assert ">search <b>13</b>" in text


def driven(summary: Summary, truth: Trajectory) -> Summary:
    """Return the run as if left alone had told a way: the true one at half the length."""
    moves = np.linalg.inv(truth.poses[1:]) @ truth.poses[:-1]
    moves[:, :3, 3] /= 2
    steps = [Step(k + 1, k, 50, 40, "", move) for k, move in enumerate(moves)]
    primary = replace(summary.series.cameras.primary, odometry=Odometry(tuple(steps), truth))
    cameras = Pair(primary, replace(summary.series.cameras.secondary, odometry=None))
    return replace(summary, series=replace(summary.series, cameras=cameras))


def test_the_map_lays_a_told_way_on_the_true_one(summary: Summary) -> None:
    turns = np.arange(30) / 30
    poses = np.tile(np.eye(4), (30, 1, 1))
    poses[:, 0, 3], poses[:, 1, 3] = 40 * np.sin(turns), 40 * np.cos(turns)
    drawn = ways(driven(summary, Trajectory(np.arange(30), poses)))
    assert drawn is not None
    assert drawn.true
    by_name = {way.whose: np.array(re.findall(r"[\d.]+", way.path), float) for way in drawn.ways}
    assert by_name["left"] == pytest.approx(by_name["truth"], abs=0.2)
    assert by_name["truth"][-2] - by_name["truth"][0] == pytest.approx(480 - 2 * 16, abs=0.5)
    assert drawn.bar_label == "5 m"
    assert drawn.bar_px == pytest.approx(5 * 448 / np.hypot(*(poses[-1] - poses[9])[:2, 3]), abs=1)
    assert ways(summarise(SyntheticRun(triggers=3))) is None


def test_a_page_without_pictures_is_smaller_and_reads_none(
    run: SyntheticRun, summary: Summary
) -> None:
    bare = render(run, summary, pictures=False)
    assert "<img" not in bare
    assert len(bare) < 200_000


def test_simulated_runs_say_so_and_real_ones_do_not(text: str) -> None:
    assert "SIMULATED" in text
    assert "SIMULATED" in page(SyntheticRun(triggers=12, cameras="gige:sim:tunnel?seed=1"))
    assert "SIMULATED" not in page(SyntheticRun(triggers=12, cameras="aravis:1801,1802?x=sim:"))


def test_the_verdict_has_the_numbers_and_claims_no_significance(summary: Summary) -> None:
    sentence = verdict(summary).replace("\u202f", "")
    for side in (summary.left, summary.right):
        median = side.inliers["orb"].median
        assert median is not None
        assert f"{median:.1f}".removesuffix(".0") in sentence
        assert side.controller in sentence
    assert "better" not in sentence
    assert "significant" not in sentence


def test_one_run_is_called_one_sample(text: str) -> None:
    assert "One run is one sample" in text


def test_the_control_experiment_is_named() -> None:
    summary = summarise(SyntheticRun(triggers=14, names=Pair("aeag", "aeag")))
    assert verdict(summary).startswith("Control run: aeag drove both cameras.")


def test_names_are_escaped() -> None:
    hostile = "</script><img src=x onerror=alert(1)>"
    run = SyntheticRun(triggers=14, names=Pair(hostile, "aeag"), lost={12: "<b>cause</b>"})
    text = page(run)
    assert hostile not in text
    assert "<b>cause" not in text
    assert "&lt;/script&gt;&lt;img" in text
    assert not [a for tag, a in Tags(text).tags if "onerror" in a]


def test_pictures_are_shown_at_the_worst_and_the_median_moments(
    summary: Summary, text: str
) -> None:
    counts = summary.camera("left").inliers["orb"]
    counted = [c for c in counts[10:] if c == c]
    worst = next(t for t in range(10, 40) if counts[t] == min(counted))
    assert f"pair {worst}</span>" in text
    assert "ours at its worst" in text
    assert "aeag at its median" in text
    images = [a for tag, a in Tags(text).tags if tag == "img"]
    assert 4 <= len(images) <= 8
    assert all((image["src"] or "").startswith("data:image/webp;base64,") for image in images)


def test_what_is_needed_to_repeat_the_run_is_there(run: SyntheticRun, text: str) -> None:
    header = run.header
    for word in (header.command, header.cameras.replace("&", "&amp;"), header.git, "wall/1"):
        assert word in text
    assert header.models["ours"] in text
    assert header.versions["numpy"] in text


def test_a_short_run_makes_a_page_without_pictures() -> None:
    text = page(SyntheticRun(triggers=3))
    assert "Nothing was counted" in text
    assert "<img" not in text


def test_a_run_without_any_complete_pair_makes_a_page() -> None:
    text = page(SyntheticRun(triggers=12, lost=dict.fromkeys(range(12), "timeout")))
    assert "Nothing was counted" in text


def test_the_file_is_small_and_the_same_every_time(
    run: SyntheticRun, summary: Summary, tmp_path: Path
) -> None:
    for name in ("a.html", "b.html"):
        write_report(tmp_path / name, run, summary)
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
    assert (tmp_path / "a.html").stat().st_size < 3_000_000


@pytest.mark.parametrize(
    ("left", "right", "expected"),
    [
        ("ours", "fixed:exposure_us=700,gain_db=0", ("ours", "fixed")),
        ("shin:tolerance=mid", "shin:tolerance=low", ("shin:tolerance=mid", "shin:tolerance=low")),
        ("fixed:gain_db=0", "fixed:gain_db=0", ("fixed (left)", "fixed (right)")),
    ],
)
def test_labels_are_as_short_as_tells_two_controllers_apart(
    left: str, right: str, expected: tuple[str, str]
) -> None:
    assert labels(left, right) == expected


@pytest.mark.parametrize(
    ("value", "places", "expected"),
    [
        (1181.0, None, "1\u202f181"),
        (1181.5, None, "1\u202f181.5"),
        (-3.25, 1, "\u22123.2"),
        (None, 0, "–"),
        (float("nan"), None, "–"),
    ],
)
def test_numbers_as_they_are_written(
    value: float | None, places: int | None, expected: str
) -> None:
    assert number(value, places) == expected


@pytest.mark.parametrize(
    ("value", "expected"), [(0.00485, "0.00485"), (7.4, "7.40"), (1234.5, "1\u202f234"), (0, "0")]
)
def test_three_significant_digits_for_what_spans_decades(value: float, expected: str) -> None:
    assert f">{expected}<" in significant(value)


def test_a_swapped_run_tells_its_wiring() -> None:
    text = page(SyntheticRun(triggers=14, options={"swap": "true"}))
    assert "aeag drove the secondary camera (SIM-1), ours the primary (SIM-0)" in text
