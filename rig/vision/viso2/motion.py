"""The camera's motion from matches: rotation, translation, and its length from the road."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rig.core.types import Intrinsics
from rig.vision.viso2.fundamental import MATCHES_MIN, fundamental, inliers
from rig.vision.viso2.symmetric import weakest_direction

Points = NDArray[np.float64]

IN_FRONT_MIN = 10
MOTION_THRESHOLD = 100.0
"""Points further away than this many steps of the camera: it hardly moved."""

GROUND_SHARE = 50.0
"""The width of the search for the ground is the median distance divided by this."""

Failure = Literal[
    "", "few matches", "few inliers", "few points in front", "too little motion", "no ground"
]
FAILURES: tuple[Failure, ...] = (
    "few matches",
    "few inliers",
    "few points in front",
    "too little motion",
    "no ground",
)


@dataclass(frozen=True, slots=True)
class Mount:
    """How the camera sits over the ground: metres above it, and radians that it looks up.

    A camera that looks down at the road has a negative pitch.
    """

    height_m: float = 1.0
    pitch_rad: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What matches tell of the camera's motion, or why they tell nothing.

    `transform` is the 4 x 4 pose of the previous camera in the current camera's frame (x right,
    y down, z forward), metres: it turns coordinates of the previous frame into the current one's.
    It is None when `failure` says why. `inlier_mask` has one entry a match.
    """

    inlier_mask: NDArray[np.bool_]
    transform: Points | None
    failure: Failure

    @property
    def inliers(self) -> int:
        """Return the number of inliers."""
        return int(self.inlier_mask.sum())


def estimate_motion(
    previous_px: NDArray[Any],
    current_px: NDArray[Any],
    intrinsics: Intrinsics,
    mount: Mount,
    seed: int,
) -> Motion:
    """Return the motion between two pictures from N matches, N x 2 points each, in full pixels."""
    mask = inliers(previous_px, current_px, seed)
    if len(current_px) < MATCHES_MIN:
        return Motion(mask, None, "few matches")
    if not mask.any():
        return Motion(mask, None, "few inliers")
    previous, current = previous_px[mask], current_px[mask]
    k = _matrix(intrinsics)
    essential = k.T @ fundamental(previous, current) @ k
    rays = [_rays(points, intrinsics) for points in (previous, current)]
    rotation, direction, points = most_in_front(decompose(essential), rays[0], rays[1])
    if len(points) < IN_FRONT_MIN:
        return Motion(mask, None, "few points in front")
    median = float(np.median(np.abs(points).sum(axis=1)))
    if median > MOTION_THRESHOLD:
        return Motion(mask, None, "too little motion")
    ground = ground_distance(points, median, mount.pitch_rad)
    if ground is None:
        return Motion(mask, None, "no ground")
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = direction * (mount.height_m / ground)
    return Motion(mask, transform, "")


def decompose(essential: Points) -> list[tuple[Points, Points]]:
    """Return the four (rotation, unit translation) that an essential matrix allows."""
    u, _, vt = np.linalg.svd(essential)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    motions = []
    for quarter in (turn, turn.T):
        rotation = u @ quarter @ vt
        rotation = rotation if np.linalg.det(rotation) > 0 else -rotation
        motions += [(rotation, u[:, 2]), (rotation, -u[:, 2])]
    return motions


def most_in_front(
    motions: Sequence[tuple[Points, Points]], previous: Points, current: Points
) -> tuple[Points, Points, Points]:
    """Return the motion that sees the most points in front, and those, M x 3, before the motion.

    `previous` and `current` are N x 2 rays (x / z, y / z).
    """
    best = (*motions[0], np.empty((0, 3)))
    for rotation, direction in motions:
        camera = np.concatenate([rotation, direction[:, None]], axis=1)
        points = np.asarray(_meet(camera, previous, current))
        ahead = (points[:, 2] > 0) & (points @ rotation[2] + direction[2] > 0)
        if ahead.sum() > len(best[2]):
            best = (rotation, direction, points[ahead])
    return best


@njit(cache=True, nogil=True)
def _meet(camera: Points, previous: Points, current: Points) -> Points:
    """Return the points, N x 3, that rays of both pictures meet best: homogeneous least squares."""
    points = np.empty((len(previous), 3))
    rows = np.zeros((4, 4))
    for i in range(len(previous)):
        rows[:] = 0.0
        rows[0, 0], rows[0, 2] = -1.0, previous[i, 0]
        rows[1, 1], rows[1, 2] = -1.0, previous[i, 1]
        for k in range(4):
            rows[2, k] = current[i, 0] * camera[2, k] - camera[0, k]
            rows[3, k] = current[i, 1] * camera[2, k] - camera[1, k]
        point = weakest_direction(rows.T @ rows)
        for k in range(3):
            points[i, k] = point[k] / point[3] if point[3] != 0.0 else np.inf
    return points


def ground_distance(points: Points, median: float, pitch_rad: float) -> float | None:
    """Return how far below the camera the ground is, in steps of the camera; None if nowhere.

    The most crowded distance d = y cos(-pitch) + z sin(-pitch) among the points (M x 3) with
    d > median / 100, by Gaussian votes of width median / 50.
    """
    below = points[:, 1] * np.cos(-pitch_rad) + points[:, 2] * np.sin(-pitch_rad)
    below = np.sort(below[below > median / MOTION_THRESHOLD])
    if below.size == 0:
        return None
    return float(below[int(_most_crowded(below, median / GROUND_SHARE))])


@njit(cache=True, nogil=True)
def _most_crowded(ordered: Points, sigma: float) -> int:
    """Return the index of the value with the most Gaussian votes, none from beyond 6 sigma."""
    best, most = 0, -1.0
    first = 0
    for i in range(len(ordered)):
        while ordered[i] - ordered[first] > 6 * sigma:
            first += 1
        votes = 0.0
        for j in range(first, len(ordered)):
            apart = (ordered[j] - ordered[i]) / sigma
            if apart > 6:
                break
            votes += np.exp(-0.5 * apart * apart)
        if votes > most:
            best, most = i, votes
    return best


def _matrix(intrinsics: Intrinsics) -> Points:
    lens = intrinsics
    return np.array([[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1]])


def _rays(points_px: NDArray[Any], lens: Intrinsics) -> Points:
    centre, focal = np.array([lens.cx_px, lens.cy_px]), np.array([lens.fx_px, lens.fy_px])
    return np.asarray((points_px - centre) / focal)
