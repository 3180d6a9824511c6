"""The ORB front end, by which exposures are judged: features, matches, inliers (thesis 5.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics
from rig.vision.matching import DESCRIPTOR_BYTES, mutual_matches

MINIMUM_MATCHES = 8
"""Fewer matches than the eight-point algorithm needs have no inliers."""

ANALYSIS_SIZE_PX = (512, 384)
"""Width and height of the picture in which the published recipe looks for features."""

Estimator = Literal["ransac", "magsac"]

_ESSENTIAL = {"ransac": cv2.RANSAC, "magsac": cv2.USAC_MAGSAC}
_FUNDAMENTAL = {"ransac": cv2.FM_RANSAC, "magsac": cv2.USAC_MAGSAC}


@dataclass(frozen=True, slots=True, eq=False)
class OrbFeatures:
    """Corners as float32 N x 2 (x, y), in pixels of the analysed picture, and N x 32 bytes."""

    points_px: NDArray[np.float32]
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points_px)


@dataclass(frozen=True, slots=True, eq=False)
class OrbMatches:
    """Matched points, row by row, and which of them fit one epipolar geometry."""

    points_a_px: NDArray[np.float32]
    points_b_px: NDArray[np.float32]
    inlier_mask: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.inlier_mask)

    @property
    def inliers(self) -> int:
        """Return the number of inliers: what a front end can work with."""
        return int(self.inlier_mask.sum())


@dataclass(frozen=True, slots=True)
class OrbFrontEnd:
    """The recipe: shrink, ORB, mutual Hamming matches, fundamental matrix by RANSAC.

    `size_px` is the width and height to analyse in (area average), None the full size.
    `ransac_px` is the largest distance of an inlier from its epipolar line. With `intrinsics`, of
    the picture before it is shrunk, an essential matrix is fitted instead. `estimator` is plain
    RANSAC or OpenCV's USAC_MAGSAC. The same pictures give the same inliers: RANSAC starts from
    `seed` at every match.
    """

    features_max: int = 2000
    size_px: tuple[int, int] | None = ANALYSIS_SIZE_PX
    ransac_px: float = 3.0
    ransac_confidence: float = 0.99
    seed: int = 0
    estimator: Estimator = "ransac"
    intrinsics: Intrinsics | None = None

    def features(self, grey: NDArray[np.uint8]) -> OrbFeatures:
        """Return the strongest features of a grey H x W picture; none is a valid answer."""
        orb = cv2.ORB.create(self.features_max)
        keypoints, descriptors = orb.detectAndCompute(self.analysed(grey), None)
        if not keypoints:
            descriptors = np.empty((0, DESCRIPTOR_BYTES), np.uint8)
        points_px = np.array([point.pt for point in keypoints], np.float32).reshape(-1, 2)
        return OrbFeatures(points_px, np.asarray(descriptors, np.uint8))

    def count(self, grey: NDArray[np.uint8]) -> int:
        """Return how many features the picture has, without describing them (M_feat)."""
        return len(cv2.ORB.create(self.features_max).detect(self.analysed(grey), None))

    def match(self, a: OrbFeatures, b: OrbFeatures) -> OrbMatches:
        """Return the mutual matches of two pictures and which are inliers (M_grid, thesis 4.2.4).

        Fewer than 8 matches have no inliers.
        """
        pairs = mutual_matches(a.descriptors, b.descriptors)
        points_a, points_b = a.points_px[pairs[:, 0]], b.points_px[pairs[:, 1]]
        return OrbMatches(points_a, points_b, self._inliers(points_a, points_b))

    def analysed(self, grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the picture in which features are looked for."""
        height_px, width_px = grey.shape
        if self.size_px is None or self.size_px == (width_px, height_px):
            return grey
        return np.asarray(cv2.resize(grey, self.size_px, interpolation=cv2.INTER_AREA), np.uint8)

    def _inliers(
        self, points_a: NDArray[np.float32], points_b: NDArray[np.float32]
    ) -> NDArray[np.bool_]:
        if len(points_a) < MINIMUM_MATCHES:
            return np.zeros(len(points_a), np.bool_)
        cv2.setRNGSeed(self.seed)
        mask = self._fit(points_a, points_b)[1]
        if mask is None:
            return np.zeros(len(points_a), np.bool_)
        return np.asarray(mask).ravel().astype(np.bool_)

    def _fit(self, points_a: NDArray[np.float32], points_b: NDArray[np.float32]) -> tuple[Any, Any]:
        limits = (self.ransac_px, self.ransac_confidence)
        if self.intrinsics is None:
            method = _FUNDAMENTAL[self.estimator]
            return cv2.findFundamentalMat(points_a, points_b, method, *limits)
        return cv2.findEssentialMat(
            points_a,
            points_b,
            self._analysed_matrix(self.intrinsics),
            method=_ESSENTIAL[self.estimator],
            prob=self.ransac_confidence,
            threshold=self.ransac_px,
        )

    def _analysed_matrix(self, lens: Intrinsics) -> NDArray[np.float64]:
        """Return the 3 x 3 of the picture that is analysed; pixel centres keep their places."""
        width_px, height_px = self.size_px or (lens.width_px, lens.height_px)
        across, down = width_px / lens.width_px, height_px / lens.height_px
        return np.array(
            [
                [lens.fx_px * across, 0.0, (lens.cx_px + 0.5) * across - 0.5],
                [0.0, lens.fy_px * down, (lens.cy_px + 0.5) * down - 0.5],
                [0.0, 0.0, 1.0],
            ]
        )
