"""Collects the views of a board that a calibration is made from, and says what is still missing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.calibration.board import Board, Corners, Grey, find_corners, what_else_is_there
from rig.calibration.quality import judge_picture
from rig.core.types import SIDES, Pair, Side

ENOUGH_VIEWS = 80
FEWEST_VIEWS = 8
MOST_VIEWS = 100
UNMOVED = "the board has not moved"

_CELLS = 3
_CELL_CORNERS = 8
_NEW_POSE_SHARE = 0.02
_TILTED_VIEWS = 4
_NEAR_VIEWS = 8
_NEAR = 0.22
_TILTED = 0.06
_PUZZLES = 4
_NOISE_DN = 0.7
_PLACES = (
    ("top left", "top", "top right"),
    ("left", "middle", "right"),
    ("bottom left", "bottom", "bottom right"),
)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One pair of pictures that shows the whole board sharply to both cameras.

    `trigger` numbers the pair; `offset_ns` is secondary minus primary device time, None where
    the pictures have no times.
    """

    trigger: int
    corners: Pair[Corners]
    offset_ns: int | None


@dataclass(slots=True, eq=False)
class ViewCollection:
    """Takes pairs of grey pictures, keeps those that teach something, and counts the others."""

    board: Board
    size_px: tuple[int, int]
    views: list[View] = field(default_factory=list)
    refused: Counter[str] = field(default_factory=Counter)
    _puzzles: int = 0
    _last: Grey | None = None

    def offer(self, trigger: int, greys: Pair[Grey], offset_ns: int | None = None) -> str:
        """Look at one pair; return why it was not kept, empty when it was."""
        complaint = self._judge(trigger, greys, offset_ns)
        if complaint:
            self.refused[complaint] += 1
        return complaint

    def _judge(self, trigger: int, greys: Pair[Grey], offset_ns: int | None) -> str:
        if not self._has_changed(greys.primary):
            return UNMOVED
        found: list[Corners] = []
        for side, grey in zip(SIDES, greys, strict=True):
            corners = find_corners(self.board, grey)
            if corners is None:
                return f"{side}: {self._why_nothing(grey)}"
            complaint = judge_picture(self.board, corners, grey).complaint
            if complaint:
                return f"{side}: {complaint}"
            found.append(corners)
        both = Pair(found[0], _same_way_round(found[0], found[1]))
        if not self._is_new(both.primary):
            return UNMOVED
        if len(self.views) >= MOST_VIEWS:
            return "enough views"
        self.views.append(View(trigger, both, offset_ns))
        return ""

    def _has_changed(self, grey: Grey) -> bool:
        """Return whether a picture differs from the one before by more than its noise."""
        small = np.asarray(cv2.resize(grey, (64, 48), interpolation=cv2.INTER_AREA), np.uint8)
        last, self._last = self._last, small
        return last is None or float(cv2.absdiff(small, last).mean()) > _NOISE_DN

    def _why_nothing(self, grey: Grey) -> str:
        """Return why no board is found; the close look is taken a few times only: it is slow."""
        if float(np.percentile(grey, 90)) >= 254:
            return "saturated: no board is found in a white-out picture; expose less"
        words = what_else_is_there(self.board, grey) if self._puzzles < _PUZZLES else ""
        self._puzzles += 1
        return words or "no board is found"

    def _is_new(self, corners: Corners) -> bool:
        """Return whether the board moved by 2 % of the width against every view that is kept."""
        for view in self.views:
            known = view.corners.primary
            shared, a, b = np.intersect1d(corners.ids, known.ids, return_indices=True)
            if len(shared):
                moved = np.linalg.norm(corners.px[a] - known.px[b], axis=1).mean()
                if moved < _NEW_POSE_SHARE * self.size_px[0]:
                    return False
        return True

    @property
    def coverage(self) -> Pair[NDArray[np.int64]]:
        """Return how many corners fell into each of 3 x 3 parts of the pictures."""
        return Pair(*(self._cells(side) for side in SIDES))

    def _cells(self, side: Side) -> NDArray[np.int64]:
        cells = np.zeros((_CELLS, _CELLS), np.int64)
        for view in self.views:
            px = getattr(view.corners, side).px
            place = np.clip(px * _CELLS // np.array(self.size_px), 0, _CELLS - 1).astype(int)
            np.add.at(cells, (place[:, 1], place[:, 0]), 1)
        return cells

    @property
    def missing(self) -> list[str]:
        """Return what to do next, most useful first; empty when there is enough of everything."""
        wanted: list[str] = []
        for side, cells in zip(SIDES, self.coverage, strict=True):
            thin = np.argwhere(cells < _CELL_CORNERS)
            wanted += [f"show the board at the {_PLACES[y][x]} of the {side} picture"
                       for y, x in thin]  # fmt: skip
        if sum(_tilt(view, self.board) > _TILTED for view in self.views) < _TILTED_VIEWS:
            wanted.append("tilt the board")
        if sum(_share(view, self.size_px) > _NEAR for view in self.views) < _NEAR_VIEWS:
            wanted.append("hold the board closer: it should fill most of the picture")
        if len(self.views) < ENOUGH_VIEWS:
            wanted.append(f"{ENOUGH_VIEWS - len(self.views)} more views")
        return wanted


def _same_way_round(primary: Corners, secondary: Corners) -> Corners:
    """Return the secondary's corners numbered as the primary's are.

    A board that looks the same upside down is found from either end; the cameras look the same
    way, so the same end must be first.
    """
    along_a = primary.px[-1] - primary.px[0]
    along_b = secondary.px[-1] - secondary.px[0]
    if float(along_a @ along_b) >= 0 or len(primary.ids) != len(secondary.ids):
        return secondary
    return Corners(secondary.ids, secondary.px[::-1].copy())


def _tilt(view: View, board: Board) -> float:
    """Return how much longer one side of the board looks than the opposite one, 0 head-on."""
    corners = view.corners.primary
    across, down = board.grid
    place = {int(corner): px for corner, px in zip(corners.ids, corners.px, strict=True)}
    ends = (0, across - 1, across * (down - 1), across * down - 1)
    if not all(end in place for end in ends):
        return 0.0
    a, b, c, d = (place[end] for end in ends)
    pairs = ((b - a, d - c), (c - a, d - b))
    ratios = [float(np.linalg.norm(p) / np.linalg.norm(q)) for p, q in pairs]
    return max(abs(math.log(ratio)) for ratio in ratios)


def _share(view: View, size_px: tuple[int, int]) -> float:
    """Return the share of the picture that the corners span."""
    hull = cv2.convexHull(view.corners.primary.px.astype(np.float32))
    return float(cv2.contourArea(hull)) / (size_px[0] * size_px[1])


def most_common(refused: Mapping[str, int], count: int = 3) -> str:
    """Return the reasons by which most pairs were lost, in words."""
    rows = Counter(dict(refused)).most_common(count)
    return "; ".join(f"{number} x {reason}" for reason, number in rows) or "no pictures were seen"
