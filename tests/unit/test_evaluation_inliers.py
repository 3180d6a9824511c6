"""Which counts exist, whom they belong to, and that both ways of counting agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_run import SyntheticRun

from rig.core.types import Lost
from rig.evaluation.inliers import InlierCounter, arrived, orb_inliers
from rig.evaluation.series import measure
from rig.vision.orb import OrbFrontEnd


def textured(shift_px: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(7)
    blocks = rng.integers(0, 255, (40, 60), dtype=np.uint8)
    wall = np.kron(blocks, np.ones((8, 8), np.uint8))
    return np.ascontiguousarray(wall[:240, shift_px : shift_px + 320])


def test_first_picture_has_no_count_and_the_next_has() -> None:
    counter = InlierCounter(OrbFrontEnd())
    assert np.isnan(counter.count(0, textured(0)))
    assert counter.count(1, textured(3)) > 200


def test_a_gap_in_the_triggers_is_not_bridged() -> None:
    counter = InlierCounter(OrbFrontEnd())
    counter.count(0, textured(0))
    assert np.isnan(counter.count(2, textured(3)))
    assert counter.count(3, textured(6)) > 200


def test_a_count_is_what_the_front_end_says_of_the_two_pictures() -> None:
    orb = OrbFrontEnd()
    matches = orb.match(orb.features(textured(0)), orb.features(textured(5)))
    counter = InlierCounter(OrbFrontEnd())
    counter.count(41, textured(0))
    assert counter.count(42, textured(5)) == matches.inliers


def test_an_incomplete_pair_takes_two_counts_from_both_cameras() -> None:
    run = SyntheticRun(triggers=8, lost={4: "timeout"})
    for series in orb_inliers(run.records()):
        assert series.triggers.tolist() == list(range(8))
        assert np.flatnonzero(np.isnan(series.counts)).tolist() == [0, 4, 5]


def test_a_mispaired_pair_counts_for_neither_although_both_frames_came() -> None:
    records = list(SyntheticRun(triggers=6).records())
    records[3] = replace(records[3], cause="sequence")
    for series in orb_inliers(records):
        assert np.flatnonzero(np.isnan(series.counts)).tolist() == [0, 3, 4]


def test_a_missing_record_is_a_gap_too() -> None:
    records = [r for r in SyntheticRun(triggers=6).records() if r.trigger != 3]
    primary, _ = orb_inliers(records)
    assert primary.triggers.tolist() == [0, 1, 2, 4, 5]
    assert np.isnan(primary.counts).tolist() == [True, False, False, True, False]


def test_both_ways_of_counting_agree() -> None:
    run = SyntheticRun(triggers=12, lost={6: "timeout"})
    series = measure(run.records())
    for camera, counted in zip(series.cameras, orb_inliers(run.records()), strict=True):
        np.testing.assert_array_equal(camera.inliers["orb"], counted.counts)


def test_no_records_give_empty_columns() -> None:
    primary, secondary = orb_inliers([])
    assert len(primary.triggers) == len(secondary.counts) == 0
    assert len(measure([])) == 0


def test_a_lost_frame_is_not_taken_for_one_that_came() -> None:
    with pytest.raises(ValueError, match=r"trigger 5 is lost: timeout"):
        arrived(Lost(5, "timeout"))


def test_columns_hold_what_was_used_and_how_bright_it_was() -> None:
    run = SyntheticRun(triggers=5)
    series = measure(run.records())
    records = list(run.records())
    camera = series.cameras.secondary
    assert camera.exposure_us.tolist() == [r.shot.secondary.used.exposure_us for r in records]  # type: ignore[union-attr]
    assert camera.gain_db.tolist() == [18.0] * 5
    assert camera.decision_ms.tolist() == [r.decisions.secondary.latency_ms for r in records]  # type: ignore[union-attr]
    assert series.light_cd_m2.tolist() == [r.truth.light_cd_m2 for r in records]  # type: ignore[union-attr]
    assert series.offset_us.tolist() == [1.5] * 5
    np.testing.assert_allclose(series.time_s, np.arange(5) * 0.1)
    assert ((camera.mean_grey_dn > 0) & (camera.mean_grey_dn < 255)).all()
