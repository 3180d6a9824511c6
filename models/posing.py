"""How far the motion that a front end finds in two pictures lies from the true one (thesis 6.3)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig.core.types import Intrinsics, Truth
from rig.vision.orb import ANALYSIS_SIZE_PX, MINIMUM_MATCHES, OrbFeatures, OrbFrontEnd

LOST_DEG = 360.0
"""The error where no motion is found: both angles as wrong as can be."""

_STANDING_M = 0.01


@dataclass(frozen=True, slots=True)
class Motion:
    """A turn (3 x 3, earlier optical frame to later one) and the direction of travel, if any."""

    rotation: NDArray[np.float64]
    direction: NDArray[np.float64] | None


def true_motion(before: Truth, after: Truth) -> Motion:
    """Return the primary camera's motion; one that stands has no direction."""
    here, there = (Rotation.from_quat(t.orientation_xyzw).as_matrix() for t in (before, after))
    back = there.T @ (np.array(before.position_m) - np.array(after.position_m))
    length_m = float(np.linalg.norm(back))
    return Motion(there.T @ here, back / length_m if length_m > _STANDING_M else None)


def pose_error_deg(a: OrbFeatures, b: OrbFeatures, lens: Intrinsics, motion: Motion) -> float:
    """Return the angle of the wrong turn plus that between the directions of travel."""
    front_end = OrbFrontEnd(ransac_px=1.0, intrinsics=lens)
    found = front_end.match(a, b)
    if found.inliers < MINIMUM_MATCHES:
        return LOST_DEG
    inside = found.inlier_mask
    points_a, points_b = (
        _normalised(points[inside], lens) for points in (found.points_a_px, found.points_b_px)
    )
    essential, mask = cv2.findEssentialMat(points_a, points_b, np.eye(3), cv2.LMEDS)
    if essential is None or essential.shape != (3, 3):
        return LOST_DEG
    _, rotation, direction, _ = cv2.recoverPose(essential, points_a, points_b, np.eye(3), mask=mask)
    wrong_turn = Rotation.from_matrix(rotation @ motion.rotation.T).magnitude()
    if motion.direction is None:
        return float(np.degrees(wrong_turn))
    cosine = np.clip(np.ravel(direction) @ motion.direction, -1.0, 1.0)
    return float(np.degrees(wrong_turn + np.arccos(cosine)))


def _normalised(points_px: NDArray[np.float32], lens: Intrinsics) -> NDArray[np.float64]:
    """Return where the rays of points in the analysed picture meet the plane at depth 1."""
    scale = np.array(ANALYSIS_SIZE_PX) / (lens.width_px, lens.height_px)
    full = (points_px + 0.5) / scale - 0.5
    return np.asarray((full - (lens.cx_px, lens.cy_px)) / (lens.fx_px, lens.fy_px), np.float64)
