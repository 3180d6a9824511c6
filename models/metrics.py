"""What makes settings good: the image metrics that targets are chosen by.

A pair of cameras samples two settings at each pose, so a target is looked for in a window of
future poses (thesis 4.2.5); a sweep samples all exposures, and a window of one pose is enough
(eq. 4.9, 4.10). The target is the settings of the picture with the most ORB features (M_feat,
eq. 4.11), of the later picture of the best-matching two (M_grid, eq. 4.12), a weighted mean of
both (M_hybrid, eq. 4.13), or by one of the metrics that the thesis weighs against these: evenly
spread features (M_uni, eq. 4.6), matches with the picture chosen before (M_seq, eq. 4.7), and the
error of the pose itself (6.3). A new metric is one function and one row of METRICS.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import UsageError


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What was measured along one unbroken stretch of n > 1 poses with K pictures each.

    `used` is n x K x 2: pose, picture, (exposure_us, gain_db). `features` is n x K: ORB features of
    each picture, `uniformity` how evenly they lie. `inliers` is n-1 x K x K: of each picture at a
    pose against each at the next, `pose_errors_deg` the errors of the motions that they find.
    A measure that the metric does not need is all zeros.
    """

    used: NDArray[np.float64]
    features: NDArray[np.int64]
    uniformity: NDArray[np.float64]
    inliers: NDArray[np.int64]
    pose_errors_deg: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Window:
    """How many poses a target may look ahead, and the weight of M_feat against M_grid."""

    poses: int = 4
    alpha: float = 0.5

    def __post_init__(self) -> None:
        if self.poses < 1:
            raise UsageError(f"--window must be at least 1 pose, got {self.poses}")
        if not 0.0 <= self.alpha <= 1.0:
            raise UsageError(f"--alpha must be between 0 and 1, got {self.alpha}")


@dataclass(frozen=True, slots=True)
class TargetMetric:
    """One way to choose targets, and what has to be measured for it.

    `choose` returns the target (exposure_us, gain_db) of the first n-1 poses, n-1 x 2. Near the
    end of the drive a window is what is left of it. Equal scores choose the earlier pose, then
    the picture that comes first, the primary camera's.
    """

    choose: Callable[[Drive, Window], NDArray[np.float64]]
    needs_features: bool = False
    needs_uniformity: bool = False
    needs_inliers: bool = False
    needs_motion: bool = False


def most_features(drive: Drive, window: Window) -> NDArray[np.float64]:
    """Choose the settings of the picture with the most features at t+1..t+window (eq. 4.11)."""
    return _best_picture(drive, drive.features, window)


def most_even(drive: Drive, window: Window) -> NDArray[np.float64]:
    """Choose the settings of the picture with the most evenly spread features (eq. 4.6)."""
    return _best_picture(drive, drive.uniformity, window)


def most_inliers(drive: Drive, window: Window) -> NDArray[np.float64]:
    """Choose the settings of the later picture of the best two in the window (eq. 4.12).

    The first of the `window` matchings is t with t+1, so the target is used at t+1..t+window.
    """
    return _best_two(drive, drive.inliers, window)


def nearest_pose(drive: Drive, window: Window) -> NDArray[np.float64]:
    """Choose the settings of the later picture of the two that give the best motion (6.3)."""
    return _best_two(drive, -drive.pose_errors_deg, window)


def most_inliers_in_sequence(drive: Drive, _window: Window) -> NDArray[np.float64]:
    """Choose, pose after pose, the picture that matches the one chosen before best (eq. 4.7).

    The first is the one with the most features. Nothing is looked for further ahead.
    """
    chosen, targets = int(drive.features[0].argmax()), []
    for pose, inliers in enumerate(drive.inliers):
        chosen = int(inliers[chosen].argmax())
        targets.append(drive.used[pose + 1, chosen])
    return np.array(targets)


def weighted_mean(drive: Drive, window: Window) -> NDArray[np.float64]:
    """Mix both choices: alpha of M_feat's and 1 - alpha of M_grid's (eq. 4.13)."""
    features, inliers = most_features(drive, window), most_inliers(drive, window)
    return window.alpha * features + (1.0 - window.alpha) * inliers


def _best_picture(drive: Drive, scores: NDArray[Any], window: Window) -> NDArray[np.float64]:
    targets = []
    for pose in range(len(drive.used) - 1):
        ahead = scores[pose + 1 : pose + 1 + window.poses]
        step, picture = np.unravel_index(np.argmax(ahead), ahead.shape)
        targets.append(drive.used[pose + 1 + step, picture])
    return np.array(targets)


def _best_two(drive: Drive, scores: NDArray[Any], window: Window) -> NDArray[np.float64]:
    targets = []
    for pose in range(len(drive.used) - 1):
        ahead = scores[pose : pose + window.poses]
        step, _, picture = np.unravel_index(np.argmax(ahead), ahead.shape)
        targets.append(drive.used[pose + 1 + step, picture])
    return np.array(targets)


METRICS: Mapping[str, TargetMetric] = MappingProxyType(
    {
        "feat": TargetMetric(most_features, needs_features=True),
        "uni": TargetMetric(most_even, needs_uniformity=True),
        "grid": TargetMetric(most_inliers, needs_inliers=True),
        "seq": TargetMetric(most_inliers_in_sequence, needs_features=True, needs_inliers=True),
        "hybrid": TargetMetric(weighted_mean, needs_features=True, needs_inliers=True),
        "pose": TargetMetric(nearest_pose, needs_motion=True),
    }
)


def find_metric(name: str) -> TargetMetric:
    """Return a metric by its name in METRICS; raises UsageError for any other."""
    if name in METRICS:
        return METRICS[name]
    close = get_close_matches(name, METRICS, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"choose from {', '.join(METRICS)}, path"
    raise UsageError(f"unknown target metric {name!r}: {hint}")
