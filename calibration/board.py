"""Calibration boards: what they look like, and where their corners are in a picture."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.core.errors import UsageError

Kind = Literal["chessboard", "charuco"]
Grey = NDArray[np.uint8]
Points = NDArray[np.float64]

_MARKER_SHARE = 0.75
_SMALLEST_GRID = 3
_REFINE_PX = (3.0, 15.0)
_LONGEST_MOVE_SHARE = 0.5
_CELL_SHARE, _GAP_SHARE = 0.4, 0.125
"""How far from a corner there is nothing but its four squares, as a share of the spacing: on a
ChArUco board the markers begin at an eighth."""


@dataclass(frozen=True, slots=True)
class Board:
    """A printed board.

    `columns` and `rows` count the inner corners of a chessboard and the squares of a ChArUco
    board (dictionary 4x4_100, markers of three quarters of a square), as their makers count them.
    """

    kind: Kind
    columns: int
    rows: int
    square_m: float

    @property
    def grid(self) -> tuple[int, int]:
        """Return how many inner corners lie in a row and in a column."""
        less = 0 if self.kind == "chessboard" else 1
        return self.columns - less, self.rows - less

    @property
    def points_m(self) -> Points:
        """Return the inner corners row by row, N x 3 metres on the board's plane."""
        across, down = self.grid
        y, x = np.mgrid[0:down, 0:across]
        flat = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)
        return flat * self.square_m

    def __str__(self) -> str:
        """Return the board as it is written on the command line."""
        return f"{self.kind}:{self.columns}x{self.rows}"


def parse_board(words: str, square_mm: float) -> Board:
    """Return the board of `chessboard:9x6`, `charuco:9x6` or `9x6`; raises UsageError."""
    found = re.fullmatch(r"(?:(chessboard|charuco):)?(\d+)x(\d+)", words)
    if not found:
        raise UsageError(
            f"--board {words!r}: write chessboard:9x6 (inner corners) or charuco:9x6 (squares)"
        )
    kind: Kind = "charuco" if found[1] == "charuco" else "chessboard"
    board = Board(kind, int(found[2]), int(found[3]), square_mm * 1e-3)
    if min(board.grid) < _SMALLEST_GRID:
        raise UsageError(f"--board {words}: needs at least {_SMALLEST_GRID} inner corners each way")
    if not 0 < square_mm < 10_000:
        raise UsageError(f"--square-mm must be above 0, got {square_mm:g}")
    return board


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """The corners seen in one picture: `ids` index `Board.points_m`, `px` are N x 2 (x, y)."""

    ids: NDArray[np.int64]
    px: Points


def find_corners(board: Board, grey: Grey) -> Corners | None:
    """Return the corners of the board in an H x W picture, in subpixels; None without a board."""
    if board.kind == "charuco":
        return _find_charuco(board, grey)
    found, px = cv2.findChessboardCornersSB(grey, board.grid, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        return None
    rough = Corners(np.arange(len(px)), np.asarray(px, np.float64).reshape(-1, 2))
    return Corners(rough.ids, _refine(grey, rough.px, _CELL_SHARE * _spacing_px(board, rough)))


def _spacing_px(board: Board, corners: Corners) -> float:
    """Return the smallest distance between corners that are neighbours on the board."""
    metres = board.points_m[corners.ids]
    apart_m = np.linalg.norm(metres[:, None] - metres[None], axis=2)
    apart_px = np.linalg.norm(corners.px[:, None] - corners.px[None], axis=2)
    neighbours = np.isclose(apart_m, board.square_m)
    return float(apart_px[neighbours].min()) if neighbours.any() else 0.0


def _refine(grey: Grey, px: Points, half_px: float) -> Points:
    """Return the corners moved to where the gradients within `half_px` agree (Forstner).

    On demosaiced pictures this halves the error of the detector's own subpixels. A corner that
    moves by half of that was drawn to something else, and stays.
    """
    half = int(min(max(half_px, _REFINE_PX[0]), _REFINE_PX[1]))
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-3)
    soft = cv2.GaussianBlur(grey, (0, 0), 1.0)
    start = px.astype(np.float32).reshape(-1, 1, 2)
    found = cv2.cornerSubPix(soft, start.copy(), (half, half), (-1, -1), stop)
    fine = np.asarray(found, np.float64).reshape(-1, 2)
    jumped = np.linalg.norm(fine - px, axis=1) > _LONGEST_MOVE_SHARE * half
    return np.where(jumped[:, None], px, fine)


def _find_charuco(board: Board, grey: Grey) -> Corners | None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
    marker_m = _MARKER_SHARE * board.square_m
    size = (board.columns, board.rows)
    layout = cv2.aruco.CharucoBoard(size, board.square_m, marker_m, dictionary)
    px, ids, _, _ = cv2.aruco.CharucoDetector(layout).detectBoard(grey)
    if ids is None or len(ids) < 2 * _SMALLEST_GRID:
        return None
    found = Corners(np.asarray(ids, np.int64).ravel(), np.asarray(px, np.float64).reshape(-1, 2))
    return Corners(found.ids, _refine(grey, found.px, _GAP_SHARE * _spacing_px(board, found)))


def what_else_is_there(board: Board, grey: Grey) -> str:
    """Return why a picture shows no such board, in words; empty when it shows no board at all.

    Looks for any smaller or larger grid of chessboard corners, which takes its time.
    """
    if board.kind == "charuco":
        return _other_charuco(board, grey)
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    found, _, cells = cv2.findChessboardCornersSBWithMeta(grey, (_SMALLEST_GRID,) * 2, flags)
    if not found:
        return ""
    down, across = np.asarray(cells).shape[:2]
    seen, wanted = sorted((int(across), int(down))), sorted(board.grid)
    if seen[0] > wanted[0] or seen[1] > wanted[1]:
        return (
            f"wrong board: it has {across}x{down} inner corners, not {board.columns}x{board.rows}"
        )
    return f"half a board: only {across}x{down} of {board.columns}x{board.rows} corners are seen"


def _other_charuco(board: Board, grey: Grey) -> str:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
    _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(grey)
    count = 0 if ids is None else len(ids)
    if count == 0:
        return ""
    expected = board.columns * board.rows // 2
    largest = int(np.max(ids))
    if largest >= expected:
        return f"wrong board: marker {largest} is seen, {board} ends at marker {expected - 1}"
    return f"half a board: only {count} of {expected} markers are seen"
