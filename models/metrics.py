"""What makes settings good: the image metrics that targets are chosen by.

A pair of cameras samples two settings at each pose, so a target is looked for in a window of
future poses (thesis 4.2.5): the settings of the picture with the most ORB features (M_feat,
eq. 4.11), of the later picture of the best-matching two (M_grid, eq. 4.12), or a weighted mean
of both (M_hybrid, eq. 4.13). A new metric is one function and one row of METRICS.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import UsageError


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What was measured along one unbroken stretch of n > 1 complete pairs.

    `used` is n x 2 x 2: pose, camera, (exposure_us, gain_db). `features` is n x 2: ORB features of
    each picture. `inliers` is n-1 x 2 x 2: of each camera at a pose against each at the next.
    A measure that the metric does not need is all zeros.
    """

    used: NDArray[np.float64]
    features: NDArray[np.int64]
    inliers: NDArray[np.int64]


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
    the primary camera.
    """

    choose: Callable[[Drive, Window], NDArray[np.float64]]
    needs_features: bool = False
    needs_inliers: bool = False


def most_features(drive: Drive, window: Window) -> NDArray[np.float64]:
    """Choose the settings of the picture with the most features at t+1..t+window (eq. 4.11)."""
    targets = []
    for pose in range(len(drive.used) - 1):
        ahead = drive.features[pose + 1 : pose + 1 + window.poses]
        step, camera = np.unravel_index(np.argmax(ahead), ahead.shape)
        targets.append(drive.used[pose + 1 + step, camera])
    return np.array(targets)


def most_inliers(drive: Drive, window: Window) -> NDArray[np.float64]:
    """Choose the settings of the later picture of the best two in the window (eq. 4.12).

    The first of the `window` matchings is t with t+1, so the target is used at t+1..t+window.
    """
    targets = []
    for pose in range(len(drive.used) - 1):
        ahead = drive.inliers[pose : pose + window.poses]
        step, _, camera = np.unravel_index(np.argmax(ahead), ahead.shape)
        targets.append(drive.used[pose + 1 + step, camera])
    return np.array(targets)


def weighted_mean(drive: Drive, window: Window) -> NDArray[np.float64]:
    """Mix both choices: alpha of M_feat's and 1 - alpha of M_grid's (eq. 4.13)."""
    features, inliers = most_features(drive, window), most_inliers(drive, window)
    return window.alpha * features + (1.0 - window.alpha) * inliers


METRICS: Mapping[str, TargetMetric] = MappingProxyType(
    {
        "feat": TargetMetric(most_features, needs_features=True),
        "grid": TargetMetric(most_inliers, needs_inliers=True),
        "hybrid": TargetMetric(weighted_mean, needs_features=True, needs_inliers=True),
    }
)


def find_metric(name: str) -> TargetMetric:
    """Return a metric by its name in METRICS; raises UsageError for any other."""
    if name in METRICS:
        return METRICS[name]
    close = get_close_matches(name, METRICS, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"choose from {', '.join(METRICS)}"
    raise UsageError(f"unknown target metric {name!r}: {hint}")
