"""How many features a picture has and how evenly they lie (thesis eq. 4.4 to 4.6)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

FEATURES_MAX = 10_000
"""Far above what a picture has, so that the count is not the cap (M_feat)."""

GRID = 10
"""Regions across and down; the thesis says S and names no number; this is Shin's grid."""


@dataclass(frozen=True, slots=True)
class FeatureScore:
    """The number of ORB features and mean / deviation of the regions' numbers."""

    count: int
    uniformity: float


def features(grey: NDArray[np.uint8]) -> FeatureScore:
    """Return both scores of a grey picture at its full size; 0 where there are no features.

    The deviation is that of the population. Equal numbers in all regions would divide by zero:
    they count as a deviation of one feature, so that the score stays finite.
    """
    keypoints = cv2.ORB.create(FEATURES_MAX).detect(grey, None)
    if not keypoints:
        return FeatureScore(0, 0.0)
    points_px = np.array([keypoint.pt for keypoint in keypoints])
    height, width = grey.shape
    columns = np.minimum(points_px[:, 0] * GRID / width, GRID - 1).astype(np.int64)
    rows = np.minimum(points_px[:, 1] * GRID / height, GRID - 1).astype(np.int64)
    numbers = np.bincount(rows * GRID + columns, minlength=GRID * GRID)
    deviation = float(numbers.std())
    return FeatureScore(len(keypoints), float(numbers.mean()) / (deviation or 1.0))
