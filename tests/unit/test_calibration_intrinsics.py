"""Intrinsics against the truth of the simulated board, and against OpenCV's own samples."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from rig.calibration.board import Board, Corners, find_corners, parse_board
from rig.calibration.export import kalibr_camchain, ros_camera_info
from rig.calibration.intrinsics import RigFit, fit_rig
from rig.calibration.pairs import of_folder
from rig.calibration.plots import residual_plot
from rig.calibration.quality import judge_picture
from rig.calibration.views import View, ViewCollection
from rig.core.errors import CalibrationError, UsageError
from rig.core.types import SIDES, Intrinsics, Pair, Side
from rig.drivers.scenes.chessboard import BASELINE_M, ChessboardScene, open_chessboard
from rig.drivers.scenes.world import lens_for

SAMPLES = Path("/usr/share/doc/opencv-doc/examples/data")
BOARD = Board("chessboard", 9, 6, 0.03)
LENS = lens_for(640, 480)
DISTORTION = "-0.2,0.05,0.001,-0.0005"
NOISE_PX = 0.05
MARGIN_M = np.array([0.03, 0.03, 0.0])


def scene(distortion: str = DISTORTION, seed: int = 4, lens: Intrinsics = LENS) -> ChessboardScene:
    return open_chessboard(seed, lens, {"distortion": distortion})


def grey(world: ChessboardScene, side: Side, index: int) -> np.ndarray:
    """Return the noiseless picture of a pose, white at 200."""
    radiance = world.view(side, (index + 0.5) * 0.2).radiance_cd_m2
    return np.clip(radiance * (200.0 / 1623.0), 0, 255).astype(np.uint8)


def sightings(world: ChessboardScene, count: int = 40) -> ViewCollection:
    """Return views whose corners are the true ones with 0.05 px of noise."""
    rng = np.random.default_rng(1)
    views = []
    for index in range(count):
        corners = []
        for side in SIDES:
            px = world.corners_px(side, world.pose(index), BOARD.points_m + MARGIN_M)
            corners.append(Corners(np.arange(54), px + rng.normal(0, NOISE_PX, px.shape)))
        views.append(View(index, Pair(*corners), 8_000))
    return ViewCollection(BOARD, (640, 480), views)


@pytest.fixture(scope="module")
def seen() -> tuple[ChessboardScene, RigFit]:
    """Calibrate from rendered pictures."""
    world = scene()
    collection = ViewCollection(BOARD, (640, 480))
    for index in range(22):
        collection.offer(index, Pair(*(grey(world, side, index) for side in SIDES)), 8_000)
    return world, fit_rig(collection)


def test_the_focal_lengths_are_recovered(seen: tuple[ChessboardScene, RigFit]) -> None:
    _, fit = seen
    for camera in fit.cameras:
        assert camera.matrix[0, 0] == pytest.approx(LENS.fx_px, rel=0.003)
        assert camera.matrix[1, 1] == pytest.approx(LENS.fy_px, rel=0.003)


def test_the_baseline_is_recovered(seen: tuple[ChessboardScene, RigFit]) -> None:
    _, fit = seen
    assert fit.stereo.baseline_m == pytest.approx(BASELINE_M, rel=0.01)
    assert fit.sync.passed


def test_undistortion_is_right_at_the_corners(seen: tuple[ChessboardScene, RigFit]) -> None:
    world, fit = seen
    ends = np.array([[[0.0, 0.0]], [[639.0, 0.0]], [[0.0, 479.0]], [[639.0, 479.0]]])
    enough = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    true_k = np.array([[LENS.fx_px, 0, LENS.cx_px], [0, LENS.fy_px, LENS.cy_px], [0, 0, 1.0]])
    true = cv2.undistortPoints(ends, true_k, np.array(world.distortion), P=true_k, criteria=enough)
    for camera in fit.cameras:
        found = cv2.undistortPoints(
            ends, camera.matrix, camera.distortion, P=true_k, criteria=enough
        )
        assert np.linalg.norm(found - true, axis=2).max() < 0.3


def test_found_corners_are_where_the_geometry_says() -> None:
    world = scene()
    points = BOARD.points_m + MARGIN_M
    found = find_corners(BOARD, grey(world, "primary", 6))
    assert found is not None
    true = world.corners_px("primary", world.pose(6), points)
    either_way = min(np.abs(found.px - t).max() for t in (true, true[::-1]))
    assert either_way < 0.25


def test_charuco_corners_are_where_the_geometry_says() -> None:
    world = open_chessboard(4, LENS, {"board": "charuco"})
    board = Board("charuco", 9, 6, 0.03)
    found = find_corners(board, grey(world, "secondary", 4))
    assert found is not None
    true = world.corners_px("secondary", world.pose(4), board.points_m + MARGIN_M)
    assert np.abs(found.px - true[found.ids]).max() < 0.4


def test_bad_views_are_dropped_with_the_reason() -> None:
    collection = sightings(scene())
    view = collection.views[7]
    shifted = view.corners.primary.px + np.random.default_rng(0).normal(0, 2.0, (54, 2))
    collection.views[7] = View(
        7, Pair(Corners(np.arange(54), shifted), view.corners.secondary), 8_000
    )
    fit = fit_rig(collection)
    assert [view.trigger for view in fit.dropped] == [7]
    assert re.match(r"primary residual \d\.\d\d px, limit \d\.\d\d px", fit.dropped[0].reason)
    assert "pair 7 dropped" in residual_plot(fit)
    assert fit.cameras.primary.matrix[0, 0] == pytest.approx(LENS.fx_px, rel=0.003)


def test_cameras_that_do_not_expose_together_fail_the_sync_check() -> None:
    collection = sightings(scene(), 30)
    rng = np.random.default_rng(2)
    for place, view in enumerate(collection.views):
        moved = view.corners.secondary.px + rng.normal(0, 3.0, 2)
        corners = Pair(view.corners.primary, Corners(np.arange(54), moved))
        collection.views[place] = View(view.trigger, corners, None)
    assert not fit_rig(collection).sync.passed


def test_late_clocks_fail_the_sync_check() -> None:
    collection = sightings(scene(), 12)
    collection.views[3] = View(3, collection.views[3].corners, 900_000)
    assert not fit_rig(collection).sync.passed


def test_swapped_cameras_are_named() -> None:
    collection = sightings(scene(), 12)
    collection.views = [
        View(v.trigger, Pair(v.corners.secondary, v.corners.primary), None)
        for v in collection.views
    ]
    with pytest.raises(CalibrationError, match=r"swapped cameras: .* 39\.\d mm left"):
        fit_rig(collection)


def test_too_few_views_are_named_with_what_went_wrong() -> None:
    collection = sightings(scene(), 3)
    collection.refused["primary: no board is found"] = 9
    with pytest.raises(
        CalibrationError, match=r"too few views: 3 good ones of at least 8 \(9 x primary: no board"
    ):
        fit_rig(collection)


def refusal(picture: np.ndarray, board: Board = BOARD) -> str:
    collection = ViewCollection(board, (640, 480))
    return collection.offer(0, Pair(picture, picture))


def test_blurred_pictures_are_named() -> None:
    blurred = cv2.GaussianBlur(grey(scene(), "primary", 4), (0, 0), 4.0)
    assert refusal(blurred).startswith("primary: blurred: edges are")


def test_saturated_pictures_are_named() -> None:
    bright = np.clip(grey(scene(), "primary", 4).astype(int) * 6, 0, 255).astype(np.uint8)
    assert refusal(bright).startswith("primary: saturated")


def test_dark_pictures_are_named() -> None:
    assert "too dark" in refusal((grey(scene(), "primary", 4) // 20).astype(np.uint8))


def test_half_a_board_is_named() -> None:
    picture = grey(scene(), "primary", 4)
    corners = find_corners(BOARD, picture)
    assert corners is not None
    picture[:, int(corners.px[:, 0].mean()) :] = 90
    assert refusal(picture).startswith("primary: half a board: only")


def test_a_wrong_board_size_is_named() -> None:
    picture = grey(scene(), "primary", 4)
    assert "wrong board: it has" in refusal(picture, Board("chessboard", 7, 5, 0.03))


def test_a_wrong_charuco_board_is_named() -> None:
    picture = grey(open_chessboard(4, LENS, {"board": "charuco"}), "primary", 4)
    board = Board("charuco", 5, 4, 0.03)
    assert "wrong board" in refusal(picture, board)


@pytest.mark.parametrize("words", ["9", "9x", "chess:9x6", "2x6", "charuco:3x9"])
def test_a_board_that_cannot_be_meant_is_refused(words: str) -> None:
    with pytest.raises(UsageError, match="--board"):
        parse_board(words, 30.0)


def test_the_coverage_says_where_the_board_is_missing() -> None:
    collection = ViewCollection(BOARD, (640, 480))
    assert collection.missing[0] == "show the board at the top left of the primary picture"
    full = sightings(scene(), 80)
    assert full.missing == []


def test_sharpness_grows_with_the_blur() -> None:
    picture = grey(scene(), "primary", 4)
    corners = find_corners(BOARD, picture)
    assert corners is not None
    soft = cv2.GaussianBlur(picture, (0, 0), 2.0)
    sharp = judge_picture(BOARD, corners, picture)
    assert sharp.edge_px < 2.5 < judge_picture(BOARD, corners, soft).edge_px


def test_exports_carry_the_numbers(seen: tuple[ChessboardScene, RigFit]) -> None:
    _, fit = seen
    ros = ros_camera_info(fit, "primary")
    matrix = re.search(r"camera_matrix:\n  rows: 3\n  cols: 3\n  data: \[([^\]]*)\]", ros)
    assert matrix is not None
    assert float(matrix[1].split(",")[0]) == pytest.approx(fit.cameras.primary.matrix[0, 0])
    assert "distortion_model: plumb_bob" in ros
    kalibr = kalibr_camchain(fit)
    assert kalibr.count("distortion_model: radtan") == 2
    shift = re.search(r"T_cn_cnm1:\n  - \[[^\]]*, ([-\d.e]+)\]", kalibr)
    assert shift is not None
    assert float(shift[1]) == pytest.approx(-BASELINE_M, rel=0.01)


@pytest.mark.skipif(not SAMPLES.is_dir(), reason="opencv-doc is not installed")
def test_opencv_samples_agree_with_their_published_calibration() -> None:
    """Published beside the pictures: left_intrinsics.yml (535.92 px; 342.28, 235.57)."""
    collection = ViewCollection(Board("chessboard", 9, 6, 0.025), (640, 480))
    for pair in of_folder(SAMPLES):
        collection.offer(pair.trigger, pair.greys)
    fit = fit_rig(collection)
    left = fit.cameras.primary.matrix
    assert len(fit.kept) >= 12
    assert left[0, 0] == pytest.approx(535.916, rel=0.006)
    assert left[0, 2] == pytest.approx(342.283, abs=2.0)
    assert left[1, 2] == pytest.approx(235.571, abs=3.0)
    assert fit.residual_px < 0.39
    assert fit.stereo.baseline_m == pytest.approx(0.0835, rel=0.01)


def test_a_folder_without_pairs_is_named(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="has no pairs of pictures; name them left01"):
        list(of_folder(tmp_path))


def test_a_picture_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    for name in ("left01.png", "right01.png"):
        (tmp_path / name).write_bytes(b"no picture")
    with pytest.raises(CalibrationError, match=r"left01\.png: cannot be read"):
        list(of_folder(tmp_path))
