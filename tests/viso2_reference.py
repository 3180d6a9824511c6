"""The matcher of the viso2-style front end once more: from its description, slow and plain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate

from rig.vision.viso2.delaunay import triangulate

Feature = tuple[int, int, int]
"""Column, row, class."""

RESPONSE_MIN, MARGIN_PX, BIN_PX = 50, 6, 50
AROUND = [
    (sx * x, sy * y)
    for x, y in ((1, 1), (3, 1), (1, 5), (5, 3))
    for sx in (-1, 1)
    for sy in (-1, 1)
]
RIGHT = [
    (0, 0),
    (0, 0),
    (0, -1),
    (0, 1),
    (-1, 0),
    (1, 0),
    (0, -2),
    (0, 2),
    (-2, -1),
    (2, -1),
    (-2, 1),
    (2, 1),
]
DOWN = [(0, -1), (0, 1), (-1, 0), (1, 0)]


def half(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    rows, columns = (size // 2 * 2 for size in grey.shape)
    wide = grey[:rows, :columns].astype(int)
    quads = wide[::2, ::2] + wide[1::2, ::2] + wide[::2, 1::2] + wide[1::2, 1::2]
    return (quads // 4).astype(np.uint8)


def blob(grey: NDArray[np.uint8]) -> NDArray[np.int64]:
    mask = -np.ones((5, 5), int)
    mask[1:4, 1:4] = 1
    mask[2, 2] = 8
    return correlate(grey.astype(int), mask, mode="nearest")


def corner(grey: NDArray[np.uint8]) -> NDArray[np.int64]:
    upper = [-1, -1, 0, 1, 1]
    lower = [1, 1, 0, -1, -1]
    mask = np.array([upper, upper, [0] * 5, lower, lower])
    return correlate(grey.astype(int), mask, mode="nearest")


def slopes(grey: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    smooth, change = np.array([1, 4, 6, 4, 1]), np.array([-1, -2, 0, 2, 1])
    right = correlate(grey.astype(int), np.outer(smooth, change), mode="nearest")
    down = correlate(grey.astype(int), np.outer(change, smooth), mode="nearest")
    return np.clip((right >> 7) + 128, 0, 255), np.clip((down >> 7) + 128, 0, 255)


def extrema(grey: NDArray[np.uint8], n: int) -> list[Feature]:
    """Block suppression: of every block of n + 1 its extremum, if it rules n around itself."""
    found = []
    rows, columns = grey.shape
    first = n + MARGIN_PX
    for pair, response in enumerate((blob(grey), corner(grey))):
        for sign, kind in ((-1, 2 * pair), (1, 2 * pair + 1)):
            signed = sign * response
            for top in range(first, rows - first, n + 1):
                for left in range(first, columns - first, n + 1):
                    block = signed[top : top + n + 1, left : left + n + 1]
                    dy, dx = np.unravel_index(np.argmax(block), block.shape)
                    y, x = int(top + dy), int(left + dx)
                    bottom = min(y + n, rows - 1 - MARGIN_PX)
                    right = min(x + n, columns - 1 - MARGIN_PX)
                    around = signed[y - n : bottom + 1, x - n : right + 1]
                    if signed[y, x] >= RESPONSE_MIN and around.max() <= signed[y, x]:
                        found.append((x, y, kind))
    return found


class Described:
    """The features of one pass: points at full size, classes and descriptors, in bin order."""

    def __init__(self, grey: NDArray[np.uint8], n: int, scale: int) -> None:
        right, down = slopes(grey)
        features = extrema(grey, n)
        features.sort(key=lambda f: (f[2], scale * f[1] // BIN_PX, scale * f[0] // BIN_PX))
        self.xy = np.array([(scale * x, scale * y) for x, y, _ in features]).reshape(-1, 2)
        self.kind = np.array([kind for _, _, kind in features])
        self.bytes = np.array(
            [
                [right[y + dy, x + dx] for dx, dy in AROUND]
                + [down[y + dy, x + dx] for dx, dy in AROUND]
                for x, y, _ in features
            ]
        ).reshape(-1, 32)

    def best(self, kind: int, wanted: NDArray[np.int64], low: list[int], high: list[int]) -> int:
        inside = (self.xy >= low).all(axis=1) & (self.xy <= high).all(axis=1) & (self.kind == kind)
        if not inside.any():
            return -1
        cost = np.abs(self.bytes - wanted).sum(axis=1)
        return int(np.argmin(np.where(inside, cost, 1 << 30)))


def there_and_back(a: Described, b: Described, bounds: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows (x, y before, x, y now) of matches; one a pixel of the current picture."""
    matches, taken = [], set()
    for i, (xy, kind) in enumerate(zip(b.xy, b.kind, strict=True)):
        low_x, high_x, low_y, high_y = bounds[xy[1] // BIN_PX, xy[0] // BIN_PX]
        if tuple(xy) in taken:
            continue
        low, high = [xy[0] + low_x, xy[1] + low_y], [xy[0] + high_x, xy[1] + high_y]
        j = a.best(kind, b.bytes[i], low, high)
        if j < 0:
            continue
        there = a.xy[j]
        low, high = [there[0] - high_x, there[1] - high_y], [there[0] - low_x, there[1] - low_y]
        if b.best(kind, a.bytes[j], low, high) == i:
            taken.add(tuple(xy))
            matches.append((*there, *xy))
    return np.array(matches, np.int64).reshape(-1, 4)


def without_outliers(matches: NDArray[np.int64]) -> NDArray[np.int64]:
    support = np.zeros(len(matches), int)
    flow = matches[:, :2] - matches[:, 2:]
    for triangle in triangulate(matches[:, 2:].astype(np.int32)):
        for a, b in ((0, 1), (1, 2), (2, 0)):
            if np.abs(flow[triangle[a]] - flow[triangle[b]]).sum() < 5:
                support[triangle[[a, b]]] += 1
    return matches[support >= 4]


def guided(matches: NDArray[np.int64], shape: tuple[int, int], radius: int) -> NDArray[np.int64]:
    """Per bin the range of the flow in it and its neighbours, widened to at least 20 px."""
    bounds = np.tile([-radius, radius, -radius, radius], (*shape, 1))
    flow, bins = matches[:, :2] - matches[:, 2:], matches[:, 2:] // BIN_PX
    for row in range(shape[0]):
        for column in range(shape[1]):
            near = (np.abs(bins - (column, row)) <= 1).all(axis=1)
            if near.any():
                for axis in range(2):
                    low, high = flow[near, axis].min(), flow[near, axis].max()
                    widen = max(0, -(-(20 - (high - low)) // 2))
                    bounds[row, column, 2 * axis : 2 * axis + 2] = low - widen, high + widen
    return bounds


def refined(
    matches: NDArray[np.int64], before: NDArray[np.uint8], now: NDArray[np.uint8]
) -> NDArray[np.int64]:
    (right_a, down_a), (right_b, down_b) = slopes(before), slopes(now)
    moved = matches.copy()
    for match in moved:
        x, y, u, v = match

        def cost(dx: int, dy: int, x: int = x, y: int = y, u: int = u, v: int = v) -> int:
            a = [right_a[y + dy + q, x + dx + p] for p, q in RIGHT]
            a += [down_a[y + dy + q, x + dx + p] for p, q in DOWN]
            b = [right_b[v + q, u + p] for p, q in RIGHT] + [down_b[v + q, u + p] for p, q in DOWN]
            return int(np.abs(np.array(a) - np.array(b)).sum())

        moves = [(dx, dy) for dy in range(-2, 3) for dx in range(-2, 3)]
        best = min(moves, key=lambda move: (cost(*move), move != (0, 0)))
        match[:2] += best
    return moved


def matched(
    before: NDArray[np.uint8], now: NDArray[np.uint8], half_resolution: bool
) -> NDArray[np.int64]:
    """Return rows (x, y before, x, y now): sparse pass, its bounds, dense pass, refinement."""
    scale, radius = (2, 100) if half_resolution else (1, 200)
    searched = [half(grey) if half_resolution else grey for grey in (before, now)]
    shape = tuple(-(-size // BIN_PX) for size in now.shape)
    everywhere = np.tile([-radius, radius, -radius, radius], (*shape, 1))
    few = [Described(grey, 9, scale) for grey in searched]
    rough = without_outliers(there_and_back(few[0], few[1], everywhere))
    many = [Described(grey, 3, scale) for grey in searched]
    fine = there_and_back(many[0], many[1], guided(rough, (shape[0], shape[1]), radius))
    return without_outliers(refined(fine, before, now))
