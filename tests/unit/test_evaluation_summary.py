"""summary.json: its keys, whose side is whose, and that a seed fixes its numbers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from synthetic_run import SyntheticRun

from rig.core.types import Pair
from rig.evaluation.front_ends import parse_front_ends
from rig.evaluation.summary import summarise
from rig.record.reader import open_recording
from rig.record.writer import RecordWriter

KEYS = [
    "schema",
    "command",
    "cameras",
    "seed",
    "world_version",
    "versions",
    "frames",
    "pairs_complete",
    "drops",
    "left",
    "right",
]


STATISTICS = ["median", "min", "mean", "p5", "blind_frames"]


def test_keys_are_the_published_ones() -> None:
    document = summarise(SyntheticRun(triggers=13)).as_json()
    assert list(document) == KEYS
    assert document["schema"] == "rig.summary/1"
    shares = ["frames_processed_pct", "mean_inlier_pct"]
    for side in (document["left"], document["right"]):
        assert side.keys() >= {"controller", "orb", "viso2", "exposure_us", "gain_db"}
        assert list(side["orb"]) == STATISTICS
        assert list(side["viso2"]) == STATISTICS + shares
        assert len(side["exposure_us"]) == len(side["gain_db"]) == 3
        assert list(side["decision_ms"]) == ["p50", "p99"]


def test_a_front_end_that_did_not_run_is_absent() -> None:
    side = summarise(SyntheticRun(triggers=13), parse_front_ends("orb")).as_json()["left"]
    assert "viso2" not in side
    assert "odometry" not in side
    assert all("viso2" not in part for part in side["segments"].values())


def test_segments_share_out_the_counted_pairs() -> None:
    run = SyntheticRun(triggers=60)
    summary = summarise(run, parse_front_ends("orb"))
    side = summary.as_json()["left"]
    assert set(side["segments"]) == {"static", "inside"}
    assert sum(part["pairs"] for part in side["segments"].values()) == 50
    counts = summary.series.cameras.primary.inliers["orb"]
    dark = next(segment for segment in summary.segments if segment.kind == "inside")
    assert side["segments"]["inside"]["orb"]["min"] == counts[dark.first : dark.last + 1].min()
    assert (dark.first, dark.last) == (24, 44)


def test_numbers_are_those_of_the_counted_series() -> None:
    summary = summarise(SyntheticRun(triggers=16))
    counts = summary.series.cameras.primary.inliers["orb"][10:]
    orb = summary.as_json()["left"]["orb"]
    assert orb["median"] == np.median(counts)
    assert orb["min"] == counts.min()
    assert orb["mean"] == counts.mean()


def test_triggers_are_complete_pairs_plus_causes() -> None:
    run = SyntheticRun(triggers=15, lost={3: "timeout", 7: "lost", 12: "timeout"})
    document = summarise(run).as_json()
    assert document["frames"] == 15
    assert document["drops"] == {"timeout": 2, "lost": 1}
    assert document["pairs_complete"] + sum(document["drops"].values()) == document["frames"]


def test_left_is_the_primary_unless_swapped() -> None:
    plain = summarise(SyntheticRun(triggers=14)).as_json()
    assert plain["left"]["controller"] == "ours"
    swapped_run = SyntheticRun(triggers=14, options={"swap": "true"}, names=Pair("ours", "aeag"))
    swapped = summarise(swapped_run).as_json()
    assert swapped["left"]["controller"] == "aeag"
    assert swapped["left"] == plain["right"]
    assert swapped["right"] == plain["left"]


def test_same_seed_same_numbers() -> None:
    first, second = (summarise(SyntheticRun(triggers=14, seed=3)).as_json() for _ in range(2))
    assert json.dumps(first) == json.dumps(second)
    assert first != summarise(SyntheticRun(triggers=14, seed=4)).as_json()


def test_a_run_of_warm_up_alone_counts_nothing() -> None:
    document = summarise(SyntheticRun(triggers=5)).as_json()
    assert document["left"]["orb"]["median"] is None
    assert document["left"]["orb"]["blind_frames"] == 0
    assert document["left"]["exposure_us"] == [None, None, None]
    assert "NaN" not in json.dumps(document)


def test_a_recording_read_back_gives_the_numbers_of_the_run_itself(tmp_path: Path) -> None:
    run = SyntheticRun(triggers=14, lost={12: "secondary: no frame in time"})
    with RecordWriter(tmp_path / "run", run.header, real_time=False) as writer:
        for record in run.records():
            writer.write(record)
    read_back = summarise(open_recording(tmp_path / "run")).as_json()
    assert read_back == summarise(run).as_json()
