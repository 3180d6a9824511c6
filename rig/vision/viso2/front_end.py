"""The front end: two pictures to matches, in a sparse pass that guides a dense one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics
from rig.vision.viso2.bucketing import bucketed
from rig.vision.viso2.features import Bins, FeatureSet, find_features
from rig.vision.viso2.filters import Gradients, blobs, corners, gradients, half
from rig.vision.viso2.fundamental import inliers
from rig.vision.viso2.matching import RADIUS_PX, flow_bounds, match_features, no_bounds, refine
from rig.vision.viso2.motion import Motion, Mount, estimate_motion
from rig.vision.viso2.outliers import supported

SPARSE_REACH_PX, DENSE_REACH_PX = 9, 3
"""How far a feature of either pass rules, in pixels of the picture that is searched."""


@dataclass(frozen=True, slots=True, eq=False)
class Viso2Features:
    """What is kept of a picture: few and many features, and its gradients at full size."""

    sparse: FeatureSet
    dense: FeatureSet
    gradients: Gradients

    def __len__(self) -> int:
        return len(self.dense)


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPoints:
    """N matches as N x 2 (x, y) points in pixels of the full pictures."""

    previous_px: NDArray[np.int32]
    current_px: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.current_px)

    def only(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> MatchedPoints:
        """Return some of the matches, by mask or by row."""
        return MatchedPoints(self.previous_px[rows], self.current_px[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Viso2Matches:
    """Matched points in pixels of the full pictures, and which of them fit one motion."""

    points_a_px: NDArray[np.int32]
    points_b_px: NDArray[np.int32]
    inlier_mask: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.inlier_mask)

    @property
    def inliers(self) -> int:
        """Return the number of inliers."""
        return int(self.inlier_mask.sum())


@dataclass(frozen=True, slots=True)
class Viso2FrontEnd:
    """The recipe of StereoScan for one camera.

    `half_resolution` looks for features in the picture of half the size and moves the matches at
    full size afterwards; the search radius is halved with it. `seed` draws bucketing and RANSAC:
    the same pictures give the same inliers.
    """

    half_resolution: bool = True
    seed: int = 0

    def features(self, grey: NDArray[np.uint8]) -> Viso2Features:
        """Return the features of a grey H x W picture; none is a valid answer."""
        full = gradients(grey)
        searched = half(grey) if self.half_resolution else grey
        slopes = gradients(searched) if self.half_resolution else full
        responses = blobs(searched), corners(searched)
        bins = Bins.of(*grey.shape)
        sparse, dense = (
            find_features(responses, slopes, reach_px, 2 if self.half_resolution else 1, bins)
            for reach_px in (SPARSE_REACH_PX, DENSE_REACH_PX)
        )
        return Viso2Features(sparse, dense, full)

    def matched(self, a: Viso2Features, b: Viso2Features) -> MatchedPoints:
        """Return the matches of two pictures, outliers of the flow removed."""
        radius_px = RADIUS_PX // 2 if self.half_resolution else RADIUS_PX
        rough = _pass(a.sparse, b.sparse, no_bounds(b.sparse.bins, radius_px))
        rough = rough.only(supported(rough.previous_px, rough.current_px))
        bounds = flow_bounds(rough.previous_px, rough.current_px, b.dense.bins, radius_px)
        fine = _pass(a.dense, b.dense, bounds)
        moved = refine(fine.previous_px, fine.current_px, a.gradients, b.gradients)
        fine = MatchedPoints(moved, fine.current_px)
        return fine.only(supported(fine.previous_px, fine.current_px))

    def match(self, a: Viso2Features, b: Viso2Features) -> Viso2Matches:
        """Return all matches of two pictures and which are inliers (tables 5.1 to 5.4)."""
        points = self.matched(a, b)
        return self.judged(points)

    def judged(self, points: MatchedPoints) -> Viso2Matches:
        """Return which of some matches fit the geometry that most of them fit."""
        mask = inliers(points.previous_px, points.current_px, self.seed)
        return Viso2Matches(points.previous_px, points.current_px, mask)

    def bucket(self, points: MatchedPoints) -> MatchedPoints:
        """Return at most two matches in every 50 x 50 px: what a motion is estimated from."""
        return points.only(bucketed(points.current_px, self.seed))

    def motion(self, points: MatchedPoints, intrinsics: Intrinsics, mount: Mount) -> Motion:
        """Return the camera's motion from bucketed matches (table 5.5)."""
        return estimate_motion(points.previous_px, points.current_px, intrinsics, mount, self.seed)


def _pass(previous: FeatureSet, current: FeatureSet, bounds: NDArray[np.int32]) -> MatchedPoints:
    pairs = match_features(previous, current, bounds)
    return MatchedPoints(previous.xy_px[pairs[:, 0]], current.xy_px[pairs[:, 1]])
