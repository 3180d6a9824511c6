"""Whether a picture of a board is good enough to measure on: sharp, and not saturated."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.calibration.board import Board, Corners, Grey

WIDEST_EDGE_PX = 5.0
"""A wider edge between black and white is blurred: its middle is not where the corner is."""

MOST_SATURATED = 0.25
"""Share of the board at the largest value from which on white has bled into black."""

FEWEST_CONTRAST_DN = 20.0

_SATURATED_DN = 254
_HALF_WINDOW_PX = 6.0
_STEPS = 25


@dataclass(frozen=True, slots=True)
class Quality:
    """`edge_px` is the width of black-white edges, `saturated` a share of the board, 0..1."""

    edge_px: float
    contrast_dn: float
    saturated: float

    @property
    def complaint(self) -> str:
        """Return what is wrong and what to do; empty when nothing is."""
        if self.saturated > MOST_SATURATED:
            return f"saturated: {self.saturated:.0%} of the board is white-out; expose less"
        if self.contrast_dn < FEWEST_CONTRAST_DN:
            return f"too dark: white is only {self.contrast_dn:.0f} above black; expose more"
        if self.edge_px > WIDEST_EDGE_PX:
            return (
                f"blurred: edges are {self.edge_px:.1f} px wide, at most {WIDEST_EDGE_PX:g}; "
                "hold the board still or focus the lens"
            )
        return ""


def judge_picture(board: Board, corners: Corners, grey: Grey) -> Quality:
    """Return how sharp and how saturated the board is in an H x W picture."""
    hull = cv2.convexHull(corners.px.astype(np.float32)).astype(np.int32)
    mask = np.zeros(grey.shape, np.uint8)
    cv2.fillConvexPoly(mask, hull, 1)
    inside = grey[mask > 0]
    saturated = float((inside >= _SATURATED_DN).mean()) if inside.size else 0.0
    low, high = np.percentile(inside, [5, 95]) if inside.size else (0.0, 0.0)
    return Quality(_edge_width_px(board, corners, grey), float(high - low), saturated)


def _edge_width_px(board: Board, corners: Corners, grey: Grey) -> float:
    """Return the larger of the median edge widths along and across the board.

    The width is the black-white step over its steepest slope, at the middle of each edge between
    two neighbouring corners; motion blurs the edges of one direction only.
    """
    across, down = board.grid
    place = np.full(across * down, -1)
    place[corners.ids] = np.arange(len(corners.ids))
    grid = place.reshape(down, across)
    widths = []
    for first, second in ((grid[:, :-1], grid[:, 1:]), (grid[:-1], grid[1:])):
        both = (first >= 0) & (second >= 0)
        if both.any():
            a, b = corners.px[first[both]], corners.px[second[both]]
            widths.append(float(np.median(_profile_widths(a, b, grey))))
    return max(widths, default=np.inf)


def _profile_widths(
    a: NDArray[np.float64], b: NDArray[np.float64], grey: Grey
) -> NDArray[np.float64]:
    length = np.linalg.norm(b - a, axis=1, keepdims=True)
    normal = (b - a)[:, ::-1] * [1.0, -1.0] / length
    half = np.minimum(_HALF_WINDOW_PX, 0.45 * length)
    steps = np.linspace(-1.0, 1.0, _STEPS)
    at = 0.5 * (a + b)[:, None] + (half * steps)[..., None] * normal[:, None]
    profile = cv2.remap(
        grey, at[..., 0].astype(np.float32), at[..., 1].astype(np.float32), cv2.INTER_LINEAR
    ).astype(np.float64)
    middle = slice(_STEPS // 4, -(_STEPS // 4))
    slope = np.abs(np.gradient(profile, axis=1))[:, middle].max(1)
    step_px = 2 * half[:, 0] / (_STEPS - 1)
    contrast = np.abs(profile[:, -3:].mean(1) - profile[:, :3].mean(1))
    local = profile.max(1) - profile.min(1)
    return np.asarray(np.maximum(contrast, 0.6 * local) / np.maximum(slope, 1e-6) * step_px)
