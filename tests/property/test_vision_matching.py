"""The matcher finds exactly what OpenCV's brute-force matcher with cross-check finds."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rig.vision.matching import mutual_matches


def descriptors(count: int, informative_bytes: int, seed: int) -> NDArray[np.uint8]:
    """Return descriptors in which few informative bytes make many ties."""
    rows = np.zeros((count, 32), np.uint8)
    rows[:, :informative_bytes] = np.random.default_rng(seed).integers(
        0, 256, (count, informative_bytes), dtype=np.uint8
    )
    return rows


def opencv(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> list[list[int]]:
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    return [[match.queryIdx, match.trainIdx] for match in matcher.match(a, b)]


@settings(deadline=None, max_examples=200)
@given(st.integers(1, 120), st.integers(1, 120), st.sampled_from([1, 2, 32]), st.integers(0, 2**32))
def test_matches_equal_opencv_in_order_and_in_ties(
    count_a: int, count_b: int, informative_bytes: int, seed: int
) -> None:
    a = descriptors(count_a, informative_bytes, seed)
    b = descriptors(count_b, informative_bytes, seed + 1)
    assert mutual_matches(a, b).tolist() == opencv(a, b)


def test_a_full_picture_of_features_equals_opencv() -> None:
    a, b = descriptors(2000, 32, 1), descriptors(1900, 32, 2)
    b[:500] = a[700:1200]
    assert mutual_matches(a, b).tolist() == opencv(a, b)


def test_nothing_matches_nothing() -> None:
    empty, some = descriptors(0, 32, 0), descriptors(5, 32, 0)
    for a, b in ((empty, some), (some, empty), (empty, empty)):
        assert mutual_matches(a, b).shape == (0, 2)


def test_another_descriptor_width_is_refused() -> None:
    with pytest.raises(ValueError, match=r"N x 32 bytes, got shape \(5, 16\)"):
        mutual_matches(np.zeros((5, 16), np.uint8), descriptors(5, 32, 0))
