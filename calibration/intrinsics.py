"""Intrinsics of both cameras and the pose between them, from views of a board.

Zhang's method as OpenCV has it, with radial and tangential distortion (k1, k2, p1, p2); k3 stays
0, because two radial terms are what Kalibr's radtan can carry and what a board that never fills
the picture's corners can tell. Views that disagree with the others are dropped, and named. Each
camera is fitted alone first; at the end both are fitted together, to one pose of the board a view,
which halves what is unknown and with it the error where no corner of the board ever was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.calibration.board import Board, Corners
from rig.calibration.views import FEWEST_VIEWS, View, ViewCollection, most_common
from rig.core.errors import CalibrationError
from rig.core.types import MAX_PAIR_OFFSET_NS, Pair

Matrix = NDArray[np.float64]
Single = NDArray[np.float32]

_ROUNDS = 6
_SPREADS = 4.0
_NEVER_BELOW_MEDIANS = 2.0
_FLOOR_PX = 0.15
_STRAY_MEDIANS = 3.0
_STRAYS_LEAVE = 0.75
_SYNC_RATIO = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class CameraFit:
    """One camera: `matrix` 3 x 3 pixels, `distortion` k1 k2 p1 p2 k3, residuals in pixels.

    `view_px` is the root-mean-square residual of each kept view; `fx_sigma_px` one standard
    deviation of the focal length as the fit states it.
    """

    matrix: Matrix
    distortion: Matrix
    residual_px: float
    view_px: Matrix
    fx_sigma_px: float


@dataclass(frozen=True, slots=True, eq=False)
class StereoFit:
    """From the primary's optical frame to the secondary's: x2 = rotation @ x1 + translation_m.

    `baseline_sigma_m` is the standard error over the views. `view_px` is each view's residual of
    one common pose; it grows with the board's speed when the cameras do not expose together.
    """

    rotation: Matrix
    translation_m: Matrix
    baseline_sigma_m: float
    residual_px: float
    view_px: Matrix

    @property
    def baseline_m(self) -> float:
        """Return the distance between the cameras."""
        return float(np.linalg.norm(self.translation_m))


@dataclass(frozen=True, slots=True, eq=False)
class DroppedView:
    """A view that was left out, and why."""

    trigger: int
    residual_px: float
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Sync:
    """Whether both cameras exposed together: by their clocks, and by what the board shows."""

    largest_offset_us: float | None
    stereo_ratio: float

    @property
    def passed(self) -> bool:
        """Return whether neither the clocks nor the pictures speak against it."""
        late = self.largest_offset_us is not None and (
            self.largest_offset_us > MAX_PAIR_OFFSET_NS / 1e3
        )
        return not late and self.stereo_ratio < _SYNC_RATIO


@dataclass(frozen=True, slots=True, eq=False)
class RigFit:
    """Both cameras, how they stand to each other, and from which views that is known."""

    board: Board
    size_px: tuple[int, int]
    cameras: Pair[CameraFit]
    stereo: StereoFit
    sync: Sync
    kept: tuple[View, ...]
    dropped: tuple[DroppedView, ...]

    @property
    def residual_px(self) -> float:
        """Return the root-mean-square reprojection error of both cameras."""
        return float(np.sqrt(np.mean([fit.residual_px**2 for fit in self.cameras])))


def fit_rig(collection: ViewCollection) -> RigFit:
    """Return the calibration; raises CalibrationError with what is missing and what to do."""
    kept, dropped = _without_strays(collection), list[DroppedView]()
    _require(kept, collection, dropped)
    for _ in range(_ROUNDS):
        cameras = Pair(*(fit_camera(collection.board, [pick(v.corners) for v in kept],
                                    collection.size_px) for pick in (_first, _second)))  # fmt: skip
        stereo = fit_stereo(collection.board, kept, cameras, collection.size_px)
        outliers = _outliers(kept, cameras, stereo)
        if not outliers:
            break
        gone = {view.trigger for view in outliers}
        dropped += outliers
        kept = [view for view in kept if view.trigger not in gone]
        _require(kept, collection, dropped)
    _refuse_swapped(stereo)
    sync = _sync(kept, cameras, stereo)
    cameras, stereo = fit_together(collection.board, kept, cameras, stereo, collection.size_px)
    return RigFit(collection.board, collection.size_px, cameras, stereo, sync, tuple(kept),
                  tuple(dropped))  # fmt: skip


def _first(corners: Pair[Corners]) -> Corners:
    return corners.primary


def _second(corners: Pair[Corners]) -> Corners:
    return corners.secondary


def _require(kept: Sequence[View], seen: ViewCollection, dropped: Sequence[DroppedView]) -> None:
    if len(kept) >= FEWEST_VIEWS:
        return
    outliers = f", {len(dropped)} dropped as outliers" if dropped else ""
    raise CalibrationError(
        f"too few views: {len(kept)} good ones of at least {FEWEST_VIEWS}{outliers} "
        f"({most_common(seen.refused)}); show the whole board {seen.board}, sharp, at different "
        "places and tilts"
    )


def _without_strays(collection: ViewCollection) -> list[View]:
    """Return the views without single corners that were found at a wrong place.

    A corner goes when it is off by three times the median of its camera: one in 500 by chance,
    and any that the detector drew to a marker, a shadow or the edge of the picture. Where more
    than a quarter would go, the view itself is wrong, and is judged as a whole later.
    """
    if len(collection.views) < FEWEST_VIEWS:
        return list(collection.views)
    sides = [
        _near_corners(collection.board, [pick(view.corners) for view in collection.views],
                      collection.size_px)
        for pick in (_first, _second)
    ]  # fmt: skip
    return [
        replace(view, corners=Pair(*corners))
        for view, *corners in zip(collection.views, *sides, strict=True)
    ]


def _near_corners(
    board: Board, views: Sequence[Corners], size_px: tuple[int, int]
) -> list[Corners]:
    """Return the corners of one camera that are near where a fit of them all has them."""
    points = [np.asarray(board.points_m[view.ids], np.float32) for view in views]
    corners = [np.asarray(view.px, np.float32).reshape(-1, 1, 2) for view in views]
    _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
        points, corners, size_px, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3
    )
    off_px = [
        np.linalg.norm(cv2.projectPoints(at, turn, shift, matrix, distortion)[0] - px, axis=(1, 2))
        for at, px, turn, shift in zip(points, corners, turns, shifts, strict=True)
    ]
    limit_px = _STRAY_MEDIANS * float(np.median(np.concatenate(off_px)))
    near = [off <= limit_px for off in off_px]
    return [
        Corners(view.ids[kept], view.px[kept]) if kept.mean() > _STRAYS_LEAVE else view
        for view, kept in zip(views, near, strict=True)
    ]


def fit_camera(board: Board, views: Sequence[Corners], size_px: tuple[int, int]) -> CameraFit:
    """Return the intrinsics of one camera from corners of at least three views."""
    points = [np.asarray(board.points_m[view.ids], np.float32) for view in views]
    corners = [np.asarray(view.px, np.float32).reshape(-1, 1, 2) for view in views]
    residual, matrix, distortion, _, _, sigma, _, per_view = cv2.calibrateCameraExtended(
        points, corners, size_px, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3
    )
    return CameraFit(
        np.asarray(matrix, np.float64),
        np.asarray(distortion, np.float64).ravel()[:5],
        float(residual),
        np.asarray(per_view, np.float64).ravel(),
        float(np.ravel(sigma)[0]),
    )


def fit_stereo(
    board: Board, views: Sequence[View], cameras: Pair[CameraFit], size_px: tuple[int, int]
) -> StereoFit:
    """Return how the secondary stands to the primary, their intrinsics held."""
    points, first, second = _seen_by_both(board, views)
    one, two = cameras
    found = cv2.stereoCalibrateExtended(
        points, first, second, one.matrix, one.distortion, two.matrix, two.distortion, size_px,
        np.eye(3), np.zeros((3, 1)), flags=cv2.CALIB_FIX_INTRINSIC,
    )  # fmt: skip
    residual, rotation, translation, per_view = found[0], found[5], found[6], found[-1]
    baselines = [_baseline(*view, one, two) for view in zip(points, first, second, strict=True)]
    return StereoFit(
        np.asarray(rotation, np.float64),
        np.asarray(translation, np.float64).ravel(),
        float(np.std(baselines) / np.sqrt(len(baselines))),
        float(residual),
        np.sqrt(np.mean(np.asarray(per_view, np.float64).reshape(len(views), -1) ** 2, axis=1)),
    )


def fit_together(
    board: Board,
    views: Sequence[View],
    cameras: Pair[CameraFit],
    stereo: StereoFit,
    size_px: tuple[int, int],
) -> tuple[Pair[CameraFit], StereoFit]:
    """Return both cameras and their stand, all fitted at once to the corners that both saw.

    Begins at fits of their own. Residuals are of the common fit; sigmas stay those of the fits
    alone, which know less.
    """
    points, first, second = _seen_by_both(board, views)
    one, two = cameras
    found = cv2.stereoCalibrateExtended(
        points, first, second, one.matrix.copy(), one.distortion.copy(), two.matrix.copy(),
        two.distortion.copy(), size_px, stereo.rotation.copy(),
        stereo.translation_m.reshape(3, 1).copy(),
        flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_USE_EXTRINSIC_GUESS | cv2.CALIB_FIX_K3,
    )  # fmt: skip
    per_view = np.asarray(found[-1], np.float64).reshape(len(views), 2)
    fits = [
        replace(
            alone,
            matrix=np.asarray(matrix, np.float64),
            distortion=np.asarray(distortion, np.float64).ravel()[:5],
            residual_px=float(np.sqrt(np.mean(residuals**2))),
            view_px=residuals,
        )
        for alone, matrix, distortion, residuals in zip(
            cameras, found[1:4:2], found[2:5:2], per_view.T, strict=True
        )
    ]
    together = replace(
        stereo,
        rotation=np.asarray(found[5], np.float64),
        translation_m=np.asarray(found[6], np.float64).ravel(),
        residual_px=float(found[0]),
        view_px=np.sqrt(np.mean(per_view**2, axis=1)),
    )
    return Pair(*fits), together


def _seen_by_both(
    board: Board, views: Sequence[View]
) -> tuple[list[Single], list[Single], list[Single]]:
    """Return points of the board and where each camera saw them, view by view."""
    points: list[Single] = []
    first: list[Single] = []
    second: list[Single] = []
    for view in views:
        a, b = view.corners
        ids, at_a, at_b = np.intersect1d(a.ids, b.ids, return_indices=True)
        points.append(np.asarray(board.points_m[ids], np.float32))
        first.append(np.asarray(a.px[at_a], np.float32).reshape(-1, 1, 2))
        second.append(np.asarray(b.px[at_b], np.float32).reshape(-1, 1, 2))
    return points, first, second


def _baseline(points: Single, a: Single, b: Single, one: CameraFit, two: CameraFit) -> float:
    """Return the baseline that a single view shows."""
    _, turn_a, shift_a = cv2.solvePnP(points, a, one.matrix, one.distortion)
    _, turn_b, shift_b = cv2.solvePnP(points, b, two.matrix, two.distortion)
    centre_a = -cv2.Rodrigues(turn_a)[0].T @ shift_a
    centre_b = -cv2.Rodrigues(turn_b)[0].T @ shift_b
    return float(np.linalg.norm(centre_a - centre_b))


def _outliers(
    views: Sequence[View], cameras: Pair[CameraFit], stereo: StereoFit
) -> list[DroppedView]:
    """Return the views far above the median residual of any of the three fits."""
    found: dict[int, DroppedView] = {}
    fits = (("primary", cameras.primary.view_px), ("secondary", cameras.secondary.view_px),
            ("stereo", stereo.view_px))  # fmt: skip
    for name, residuals in fits:
        middle = float(np.median(residuals))
        spread = 1.4826 * float(np.median(np.abs(residuals - middle)))
        limit = max(middle + _SPREADS * spread, _NEVER_BELOW_MEDIANS * middle, _FLOOR_PX)
        for view, residual in zip(views, residuals, strict=True):
            if residual > limit and view.trigger not in found:
                reason = f"{name} residual {residual:.2f} px, limit {limit:.2f} px"
                found[view.trigger] = DroppedView(view.trigger, float(residual), reason)
    return list(found.values())


def _refuse_swapped(stereo: StereoFit) -> None:
    """The secondary stands to the right of the primary (thesis 4.1), so x2 = x1 - baseline."""
    if stereo.translation_m[0] > 0.5 * stereo.baseline_m:
        raise CalibrationError(
            f"swapped cameras: the secondary is {stereo.baseline_m * 1e3:.1f} mm left of the "
            "primary; exchange the serials of primary and secondary, or the two picture folders"
        )


def _sync(kept: Sequence[View], cameras: Pair[CameraFit], stereo: StereoFit) -> Sync:
    offsets_us = [abs(view.offset_ns) / 1e3 for view in kept if view.offset_ns is not None]
    alone = float(np.sqrt(np.mean([fit.residual_px**2 for fit in cameras])))
    largest = max(offsets_us) if offsets_us else None
    return Sync(largest, stereo.residual_px / max(alone, 1e-6))
