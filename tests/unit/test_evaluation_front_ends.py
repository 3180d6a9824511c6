"""How front ends are named on the command line, and what comparing two pictures tells."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.core.errors import UsageError
from rig.core.types import Intrinsics
from rig.evaluation.front_ends import FRONT_ENDS, OrbRecipe, Viso2Recipe, parse_front_ends
from rig.evaluation.inliers import InlierCounter
from rig.evaluation.odometry import OdometryCounter

LENS = Intrinsics(640, 480, 564.0, 564.0, 319.5, 239.5)


@pytest.fixture(scope="module")
def pair() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    noise = np.random.default_rng(4).integers(0, 256, (480, 660), dtype=np.uint8)
    smooth = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2), None, 0, 255, cv2.NORM_MINMAX)
    wide = np.asarray(smooth, np.uint8)
    return np.ascontiguousarray(wide[:, :640]), np.ascontiguousarray(wide[:, 20:])


def test_names_and_options() -> None:
    chosen = parse_front_ends("orb:size=full,features=5000,estimator=magsac, viso2:half=no")
    orb, viso2 = chosen["orb"], chosen["viso2"]
    assert isinstance(orb, OrbRecipe)
    assert isinstance(viso2, Viso2Recipe)
    assert (orb.plain.size_px, orb.plain.features_max) == (None, 5000)
    assert orb.plain.estimator == "magsac"
    assert viso2.plain.half_resolution is False
    assert parse_front_ends("orb,viso2") == FRONT_ENDS
    mount = parse_front_ends("viso2:height_m=2,pitch_deg=-3")["viso2"]
    assert isinstance(mount, Viso2Recipe)
    assert (mount.mount.height_m, mount.mount.pitch_rad) == (2.0, math.radians(-3))
    small = parse_front_ends("orb:size=320x240,threshold_px=1.5")["orb"]
    assert isinstance(small, OrbRecipe)
    assert (small.plain.size_px, small.plain.ransac_px) == ((320, 240), 1.5)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("obr", r"unknown front end 'obr', did you mean orb\?"),
        ("sift", r"unknown front end 'sift'; there are: orb, viso2"),
        ("orb,orb", r"front end orb is named twice"),
        ("orb:featuers=3", r"unknown option of orb 'featuers', did you mean features\?"),
        ("orb:features=0", r"orb:features=0: write a whole number from 1 to 100000"),
        ("orb:size=10x10", r"orb:size=10x10: write WIDTHxHEIGHT, at least 32x32, or full"),
        ("orb:threshold_px=nan", r"write a number above 0"),
        ("orb:estimator=lmeds", r"write ransac or magsac"),
        ("orb:features", r"'features' of orb: write option=value"),
        ("features=3", r"'features=3' in 'features=3' belongs to no front end"),
        ("viso2:half=perhaps", r"write yes or no"),
        ("viso2:pitch_deg=90", r"write degrees between -90 and 90"),
        ("", r"unknown front end ''"),
    ],
)
def test_what_makes_no_front_end_is_one_line(text: str, problem: str) -> None:
    with pytest.raises(UsageError, match=problem):
        parse_front_ends(text)


def test_an_essential_matrix_needs_the_lens() -> None:
    recipe = parse_front_ends("orb:geometry=essential")["orb"]
    with pytest.raises(UsageError, match="needs the lens"):
        recipe.counter(None)
    assert isinstance(recipe.counter(LENS), InlierCounter)


def test_motion_is_told_where_the_lens_is_known() -> None:
    recipe = FRONT_ENDS["viso2"]
    assert isinstance(recipe.counter(None), InlierCounter)
    assert isinstance(recipe.counter(LENS), OdometryCounter)


@pytest.mark.parametrize(
    "options",
    [
        "orb",
        "orb:size=full",
        "orb:estimator=magsac",
        "orb:geometry=essential",
        "orb:geometry=essential,estimator=magsac,size=full",
        "orb:features=300",
    ],
)
def test_every_recipe_of_orb_finds_the_shift(
    options: str, pair: tuple[NDArray[np.uint8], NDArray[np.uint8]]
) -> None:
    recipe = parse_front_ends(options)["orb"]
    told = recipe.compare(*pair, LENS)
    assert told.counts["matches"] > 150
    assert 0.85 * told.counts["matches"] < told.counts["inliers"] <= told.counts["matches"]
    assert told.failure is None
    assert told.ms > 0
    counter = recipe.counter(LENS)
    counter.count(0, pair[0])
    assert counter.count(1, pair[1]) == told.counts["inliers"]


def test_viso2_tells_all_and_bucketed_matches_and_why_no_motion(
    pair: tuple[NDArray[np.uint8], NDArray[np.uint8]],
) -> None:
    told = FRONT_ENDS["viso2"].compare(*pair, None)
    assert list(told.counts) == ["matches", "inliers", "bucketed", "bucketed_inliers"]
    assert told.counts["matches"] > told.counts["bucketed"] >= 10
    assert told.failure is None
    flat = np.zeros((480, 640), np.uint8)
    assert FRONT_ENDS["viso2"].compare(flat, pair[1], LENS).failure == "few matches"
