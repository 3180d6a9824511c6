"""The world `chessboard`: somebody holds a calibration board before the two cameras.

The board is drawn pixel by pixel from its exact geometry: each of 16 samples a pixel follows its
ray, through the lens distortion, to the board's plane. So every corner is where the pinhole model
with radial and tangential distortion (Brown 1966, OpenCV's k1 k2 p1 p2 k3) says, to numerical
accuracy. A pose is held for two tenths of a second; the poses go round the picture, so that the
board comes to every corner of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import cv2
import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig.core.errors import UsageError
from rig.core.types import Intrinsics, Side, Truth
from rig.drivers.scenes.trajectories import Vector
from rig.drivers.scenes.wall import StillView

CHESSBOARD_VERSION = "chessboard/3"
BASELINE_M = 0.0392
"""Distance between the two cameras (thesis 5.1.1)."""

OPTIONS = ("board", "distortion")

_HOLD_S = 0.2
_DRIVE_S = 18.0
_LUX = 2_000.0
_WHITE, _BLACK, _WALL = 0.85, 0.04, 0.35
_SQUARE_M = 0.03
_MARGIN_SQUARES = 1
_WALL_M = 3.0
_SAMPLES = 16
_TURNED = (0, 8, 4, 12, 2, 10, 6, 14, 1, 9, 5, 13, 3, 11, 7, 15)
"""Bits of 0..15 reversed: samples whose rows and columns are all different (Hammersley), so that
an edge along the pixels moves in sixteenths of one."""
_FILL = (0.6, 0.95)
_TILT_RAD = 0.6
_EDGE_PX_PER_WIDTH = 0.006


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """A printed board: equal cells of black (0) and white (1), with a white margin around.

    `cells` has row 0 at the top. A cell is `cell_m` wide; the origin is the outer corner of the
    first square, x to the right, y down.
    """

    cells: NDArray[np.uint8]
    cell_m: float
    margin_cells: int

    @property
    def size_m(self) -> tuple[float, float]:
        """Return width and height of the printed squares, without the margin."""
        high, wide = (side - 2 * self.margin_cells for side in self.cells.shape)
        return wide * self.cell_m, high * self.cell_m


def chess_sheet(columns: int = 9, rows: int = 6) -> Sheet:
    """Return a chessboard of `columns` by `rows` inner corners and 30 mm squares."""
    y, x = np.mgrid[0 : rows + 1, 0 : columns + 1]
    squares = ((x + y) % 2).astype(np.uint8)
    return Sheet(np.pad(squares, _MARGIN_SQUARES, constant_values=1), _SQUARE_M, _MARGIN_SQUARES)


def charuco_sheet(columns: int = 9, rows: int = 6) -> Sheet:
    """Return a ChArUco board of `columns` by `rows` squares of 30 mm with 22.5 mm markers."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
    board = cv2.aruco.CharucoBoard((columns, rows), _SQUARE_M, 0.75 * _SQUARE_M, dictionary)
    picture = board.generateImage((columns * 8, rows * 8), None, 0, 1)
    cells = (np.asarray(picture) > 127).astype(np.uint8)
    margin = 8 * _MARGIN_SQUARES
    return Sheet(np.pad(cells, margin, constant_values=1), _SQUARE_M / 8, margin)


SHEETS = {"chessboard": chess_sheet, "charuco": charuco_sheet}


@dataclass(frozen=True, slots=True)
class BoardPose:
    """Where the board is: from board coordinates to the primary's optical frame, metres."""

    rotation: NDArray[np.float64]
    translation_m: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ChessboardScene:
    """A `Scene`: a board in changing poses before two cameras with a known lens."""

    sheet: Sheet
    lens: Intrinsics
    distortion: tuple[float, ...]
    seed: int
    _rays: list[NDArray[np.float32]] = field(default_factory=list)
    _views: dict[tuple[Side, int], StillView] = field(default_factory=dict)

    @property
    def world_version(self) -> str:
        """Return the version of this world."""
        return CHESSBOARD_VERSION

    @property
    def drive_s(self) -> float:
        """Return how long the board is held up, seconds."""
        return _DRIVE_S

    def intrinsics(self, side: Side) -> Intrinsics:
        """Return the intrinsics with the distortion; both cameras are alike."""
        k1, k2, p1, p2, k3 = self.distortion
        return replace(self.lens, distortion=(k1, k2, p1, p2, k3))

    def view(self, side: Side, time_s: float) -> StillView:
        """Return what one camera sees; the board is still while a pose is held."""
        key = (side, held(time_s))
        if key not in self._views:
            while len(self._views) >= 4:
                self._views.pop(next(iter(self._views)), None)
            self._views[key] = self._render(side, self.pose(key[1]))
        return self._views[key]

    def truth(self, time_s: float) -> Truth:
        """Return where the primary camera is, which stands still, and how bright its view is."""
        light = float(self.view("primary", time_s).radiance_cd_m2.mean(dtype=np.float64))
        return Truth((0.0, 0.0, 0.0), (-0.5, 0.5, -0.5, 0.5), light)

    def pose(self, index: int) -> BoardPose:
        """Return the `index`-th pose of the board."""
        rng = np.random.default_rng([self.seed, index, 1971])
        tilt = Rotation.from_euler(
            "xyz", [*rng.uniform(-_TILT_RAD, _TILT_RAD, 2), rng.uniform(-0.5, 0.5)]
        ).as_matrix()
        width_m, height_m = self.sheet.size_m
        middle = tilt @ [0.5 * width_m, 0.5 * height_m, 0.0]
        fill = rng.uniform(*_FILL)
        distance_m = self.lens.fx_px * width_m / (fill * self.lens.width_px)
        aim = _aim(index, rng)
        shift = np.array([0.0, 0.0, distance_m])
        for _ in range(6):
            shift += self._towards(aim, BoardPose(tilt, shift - middle))
        return BoardPose(tilt, shift - middle)

    def corners_px(self, side: Side, pose: BoardPose, points_m: Vector) -> NDArray[np.float64]:
        """Return where points of the board (N x 3 metres) are in a picture, N x 2 pixels."""
        turned, _ = cv2.Rodrigues(pose.rotation)
        matrix = _matrix(self.lens)
        offset = pose.translation_m - [_right_m(side), 0.0, 0.0]
        found, _ = cv2.projectPoints(points_m, turned, offset, matrix, np.array(self.distortion))
        return np.asarray(found.reshape(-1, 2), np.float64)

    def _towards(self, aim: NDArray[np.float64], pose: BoardPose) -> NDArray[np.float64]:
        """Return how to shift the board so that it lies at `aim`, 0..1 of the free space."""
        wide, high = self.sheet.size_m
        outline = np.array([[0.0, 0.0, 0.0], [wide, 0, 0], [wide, high, 0], [0, high, 0]])
        both = np.concatenate([self.corners_px("primary", pose, outline),
                               self.corners_px("secondary", pose, outline)])  # fmt: skip
        low, top = both.min(0), both.max(0)
        edge = _EDGE_PX_PER_WIDTH * self.lens.width_px
        free = np.array([self.lens.width_px, self.lens.height_px]) - 2 * edge - (top - low)
        depth_m = pose.translation_m[2]
        move = (edge + aim * np.maximum(free, 0.0) - low) * depth_m / self.lens.fx_px
        back = 1.0 + 0.5 * max(
            0.0, float((-free / [self.lens.width_px, self.lens.height_px]).max())
        )
        return np.array([move[0], move[1], depth_m * (back - 1.0)])

    def _render(self, side: Side, pose: BoardPose) -> StillView:
        if not self._rays:
            self._rays.append(_corner_rays(self.lens, self.distortion))
        offset = pose.translation_m - [_right_m(side), 0.0, 0.0]
        to_board = np.linalg.inv(np.column_stack([pose.rotation[:, :2], offset]))
        albedo = np.array([_BLACK, _WHITE, _WALL], np.float32) * np.float32(_LUX / math.pi)
        shape = (self.lens.height_px, self.lens.width_px)
        radiance, depth_m = np.empty(shape, np.float32), np.empty(shape, np.float32)
        sheet = self.sheet
        _draw(self._rays[0], to_board, sheet.cells, sheet.cell_m, sheet.margin_cells, albedo,
              radiance, depth_m)  # fmt: skip
        return StillView(radiance, depth_m)


def held(time_s: float) -> int:
    """Return which pose is held at a time."""
    return math.floor(time_s / _HOLD_S + 1e-6)


def open_chessboard(seed: int, lens: Intrinsics, options: Mapping[str, str]) -> ChessboardScene:
    """Return the scene; raises UsageError for an unknown board or a malformed distortion."""
    board = options.get("board", "chessboard")
    if board not in SHEETS:
        raise UsageError(f"sim:chessboard: board must be {' or '.join(SHEETS)}, got {board!r}")
    return ChessboardScene(SHEETS[board](), lens, _distortion(options.get("distortion", "0")), seed)


def _distortion(words: str) -> tuple[float, ...]:
    try:
        numbers = [float(word) for word in words.split(",")]
    except ValueError:
        numbers = []
    if not 1 <= len(numbers) <= 5 or not all(abs(number) <= 1.0 for number in numbers):
        raise UsageError(
            "sim:chessboard: distortion must be up to five numbers k1,k2,p1,p2,k3 of at most 1, "
            f"got {words!r}"
        )
    return tuple(numbers + [0.0] * (5 - len(numbers)))


def _aim(index: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return where the board goes, 0..1 of the free space: mostly into the corners."""
    corners = [(0, 0), (1, 0), (0, 1), (1, 1)]
    grid = [*corners, (0.5, 0.5), *corners, (0.5, 0), (0, 0.5), (1, 0.5), (0.5, 1)]
    place = index % (len(grid) + 2)
    return np.array(grid[place], float) if place < len(grid) else rng.uniform(0, 1, 2)


def _right_m(side: Side) -> float:
    return 0.0 if side == "primary" else BASELINE_M


def _matrix(lens: Intrinsics) -> NDArray[np.float64]:
    return np.array([[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1.0]])


def _corner_rays(lens: Intrinsics, distortion: tuple[float, ...]) -> NDArray[np.float32]:
    """Return the ray (x/z, y/z) of every corner between pixels, (H + 1) x (W + 1) x 2."""
    y, x = np.mgrid[0 : lens.height_px + 1, 0 : lens.width_px + 1]
    corners = np.stack([x - 0.5, y - 0.5], 2).reshape(-1, 1, 2).astype(np.float64)
    enough = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
    rays = cv2.undistortPoints(corners, _matrix(lens), np.array(distortion), criteria=enough)
    return np.asarray(rays.reshape(*x.shape, 2), np.float32)


@nb.njit(parallel=True, cache=True, fastmath=True, nogil=True)
def _draw(  # type: ignore[no-untyped-def]
    rays, to_board, cells, cell_m, margin, shades, radiance, depth_m
):
    """Fill radiance (cd/m2) and depth (m) of one view, 16 samples a pixel."""
    height, width = radiance.shape
    high, wide = cells.shape
    for row in nb.prange(height):
        y = np.int64(row)
        for x in range(width):
            total = np.float32(0)
            far = 0.0
            for k in range(_SAMPLES):
                p = (k + 0.5) / _SAMPLES
                q = (_TURNED[k] + 0.5) / _SAMPLES
                a = (rays[y, x, 0] * (1 - p) + rays[y, x + 1, 0] * p) * (1 - q) + (
                    rays[y + 1, x, 0] * (1 - p) + rays[y + 1, x + 1, 0] * p
                ) * q
                b = (rays[y, x, 1] * (1 - p) + rays[y, x + 1, 1] * p) * (1 - q) + (
                    rays[y + 1, x, 1] * (1 - p) + rays[y + 1, x + 1, 1] * p
                ) * q
                w = to_board[2, 0] * a + to_board[2, 1] * b + to_board[2, 2]
                u = (to_board[0, 0] * a + to_board[0, 1] * b + to_board[0, 2]) / w
                v = (to_board[1, 0] * a + to_board[1, 1] * b + to_board[1, 2]) / w
                column = math.floor(u / cell_m) + margin
                line = math.floor(v / cell_m) + margin
                inside = w > 0 and 0 <= column < wide and 0 <= line < high
                total += shades[cells[line, column]] if inside else shades[2]
                far += 1.0 / w if inside else _WALL_M
            radiance[y, x] = total / _SAMPLES
            depth_m[y, x] = far / _SAMPLES
