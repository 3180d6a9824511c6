"""The ORB front end counts what moves together and nothing else."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.vision.orb import OrbFeatures, OrbFrontEnd


@pytest.fixture(scope="module")
def picture() -> NDArray[np.uint8]:
    noise = np.random.default_rng(3).integers(0, 256, (480, 640), dtype=np.uint8)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2)
    return np.asarray(cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX), np.uint8)


def test_a_picture_and_its_shifted_copy_share_most_features(picture: NDArray[np.uint8]) -> None:
    front_end = OrbFrontEnd()
    before = front_end.features(picture)
    after = front_end.features(np.roll(picture, 10, axis=1))
    matches = front_end.match(before, after)
    assert 1500 < len(before) <= 2000
    assert len(matches) > 1000
    assert matches.inliers > 0.9 * len(matches)
    shift_px = (matches.points_b_px - matches.points_a_px)[matches.inlier_mask]
    assert np.median(shift_px, axis=0) == pytest.approx([10 * 512 / 640, 0], abs=0.5)


def test_unrelated_pictures_share_few_inliers(picture: NDArray[np.uint8]) -> None:
    front_end = OrbFrontEnd()
    matches = front_end.match(
        front_end.features(picture), front_end.features(np.ascontiguousarray(picture[::-1]))
    )
    assert matches.inliers < 0.2 * len(matches)


def test_the_same_pictures_give_the_same_inliers(picture: NDArray[np.uint8]) -> None:
    front_end = OrbFrontEnd()
    a = front_end.features(picture)
    b = front_end.features(np.roll(picture[:, ::-1], 3, axis=0))
    first = front_end.match(a, b).inlier_mask
    cv2.setRNGSeed(99)
    assert np.array_equal(front_end.match(a, b).inlier_mask, first)


@pytest.mark.parametrize("value", [0, 255])
def test_a_flat_picture_has_nothing_to_match(picture: NDArray[np.uint8], value: int) -> None:
    front_end = OrbFrontEnd()
    flat = front_end.features(np.full((480, 640), value, np.uint8))
    assert len(flat) == 0
    for a, b in ((flat, front_end.features(picture)), (flat, flat)):
        assert front_end.match(a, b).inliers == 0


def test_fewer_than_eight_matches_have_no_inliers() -> None:
    rng = np.random.default_rng(0)
    for count, inliers in ((7, 0), (8, 8)):
        points_px = rng.uniform(0, 300, (count, 2)).astype(np.float32)
        features = OrbFeatures(points_px, rng.integers(0, 256, (count, 32), dtype=np.uint8))
        matches = OrbFrontEnd().match(features, features)
        assert (len(matches), matches.inliers) == (count, inliers)


def test_options_change_the_recipe(picture: NDArray[np.uint8]) -> None:
    assert len(OrbFrontEnd(features_max=100).features(picture)) == 100
    full = OrbFrontEnd(size_px=None).features(picture)
    assert full.points_px.max() > 512
    assert OrbFrontEnd().count(picture) == len(OrbFrontEnd().features(picture))
