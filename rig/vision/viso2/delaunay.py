"""The Delaunay triangulation of whole-numbered points, in exact arithmetic."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

COORDINATE_MAX = 1 << 14
"""Up to here every determinant fits 64 bits, so that no sign is ever rounded."""

_CURVE_BITS = 14


def triangulate(points: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return M x 3 rows of N x 2 whole points (0..16383): the Delaunay triangles.

    A point that stands on an earlier one is in no triangle; points on one line have none. Raises
    ValueError for coordinates out of range. Incremental (Bowyer, Watson 1981), with one vertex at
    infinity, in the order of a Hilbert curve; where four points share a circle either diagonal
    may come.
    """
    if len(points) and (points.min() < 0 or points.max() >= COORDINATE_MAX):
        raise ValueError(f"points must lie in 0..{COORDINATE_MAX - 1}, got {points.max()}")
    order = np.argsort(_along_curve(points), kind="stable")
    triangles = _triangulate(points[order].astype(np.int64))
    return np.asarray(order[triangles], np.int32)


@njit(cache=True, nogil=True)
def _along_curve(points: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return how far along a Hilbert curve each point is."""
    keys = np.empty(len(points), np.int64)
    for i in range(len(points)):
        x, y = np.int64(points[i, 0]), np.int64(points[i, 1])
        key = np.int64(0)
        side = np.int64(1) << (_CURVE_BITS - 1)
        while side > 0:
            right, low = np.int64((x & side) > 0), np.int64((y & side) > 0)
            key += side * side * ((3 * right) ^ low)
            if low == 0:
                if right == 1:
                    x, y = COORDINATE_MAX - 1 - x, COORDINATE_MAX - 1 - y
                x, y = y, x
            side >>= 1
        keys[i] = key
    return keys


@njit(cache=True, nogil=True)
def _triangulate(points: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the triangles of distinct points, given in an order in which near ones follow."""
    count = len(points)
    second, third = _first_corners(points)
    if third < 0:
        return np.empty((0, 3), np.int64)
    infinite = count
    corners = np.empty((2 * count + 2, 3), np.int64)
    beside = np.empty((2 * count + 2, 3), np.int64)
    total = _begin(points, second, third, corners, beside)
    seen = np.full(2 * count + 2, -1)
    starting = np.empty(count + 1, np.int64)
    cavity = np.empty(2 * count + 2, np.int64)
    rim = np.empty((2 * count + 2, 4), np.int64)
    last = 0
    for point in range(1, count):
        if point in (second, third):
            continue
        at = _locate(points, corners, beside, infinite, last, point)
        if at < 0:
            continue
        holes, edges = _carve(points, corners, beside, infinite, at, point, seen, cavity, rim)
        for edge in range(edges):
            new = cavity[edge] if edge < holes else total + edge - holes
            a, b, outer, old = rim[edge]
            corners[new] = point, a, b
            seen[new] = -1
            beside[new, 0] = outer
            for k in range(3):
                if beside[outer, k] == old and corners[outer, (k + 1) % 3] == b:
                    beside[outer, k] = new
            starting[a] = new
        for edge in range(edges):
            new, following = starting[rim[edge, 0]], starting[rim[edge, 1]]
            beside[new, 1] = following
            beside[following, 2] = new
        total += edges - holes
        last = starting[rim[0, 0]]
    kept = np.empty((total, 3), np.int64)
    finite = 0
    for triangle in range(total):
        if corners[triangle].max() < infinite:
            kept[finite] = corners[triangle]
            finite += 1
    return kept[:finite]


@njit(cache=True, nogil=True)
def _first_corners(points: NDArray[np.int64]) -> tuple[int, int]:
    """Return two points that make a triangle with point 0; -1 for points on a line."""
    second = -1
    for i in range(1, len(points)):
        if second < 0:
            if points[i, 0] != points[0, 0] or points[i, 1] != points[0, 1]:
                second = i
        elif _turn(points, 0, second, i) != 0:
            return second, i
    return second, -1


@njit(cache=True, nogil=True)
def _begin(
    points: NDArray[np.int64],
    second: int,
    third: int,
    corners: NDArray[np.int64],
    beside: NDArray[np.int64],
) -> int:
    """Write the first triangle and the three to infinity around it; return their number."""
    infinite = len(points)
    if _turn(points, 0, second, third) < 0:
        second, third = third, second
    first = (0, second, third)
    corners[0] = first
    for k in range(3):
        a, b = first[(k + 1) % 3], first[(k + 2) % 3]
        corners[k + 1] = infinite, b, a
        beside[0, k] = k + 1
        beside[k + 1, 0] = 0
        beside[k + 1, 1] = (k + 2) % 3 + 1
        beside[k + 1, 2] = (k + 1) % 3 + 1
    return 4


@njit(cache=True, nogil=True)
def _turn(points: NDArray[np.int64], a: int, b: int, c: int) -> Any:
    """Return twice the signed area of a triangle: > 0 for a turn to the left."""
    ax, ay = points[a]
    bx, by = points[b]
    cx, cy = points[c]
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@njit(cache=True, nogil=True)
def _locate(
    points: NDArray[np.int64],
    corners: NDArray[np.int64],
    beside: NDArray[np.int64],
    infinite: int,
    start: int,
    point: int,
) -> int:
    """Return a triangle that holds the point, or one to infinity; -1 if it stands on a corner."""
    at = start
    for k in range(3):
        if corners[at, k] == infinite:
            at = beside[at, k]
            break
    moved = True
    while moved:
        moved = False
        for k in range(3):
            a, b = corners[at, (k + 1) % 3], corners[at, (k + 2) % 3]
            if _turn(points, a, b, point) < 0:
                at = beside[at, k]
                moved = True
                break
        if moved and corners[at].max() == infinite:
            return at
    for k in range(3):
        corner = corners[at, k]
        if points[corner, 0] == points[point, 0] and points[corner, 1] == points[point, 1]:
            return -1
    return at


@njit(cache=True, nogil=True)
def _carve(
    points: NDArray[np.int64],
    corners: NDArray[np.int64],
    beside: NDArray[np.int64],
    infinite: int,
    start: int,
    point: int,
    seen: NDArray[np.int64],
    cavity: NDArray[np.int64],
    rim: NDArray[np.int64],
) -> tuple[int, int]:
    """List the triangles whose circle holds the point, and the edges around them.

    An edge is (a, b, triangle outside, triangle inside). Returns the numbers of both.
    """
    cavity[0] = start
    seen[start] = point
    holes, edges, done = 1, 0, 0
    while done < holes:
        triangle = cavity[done]
        done += 1
        for k in range(3):
            other = beside[triangle, k]
            if seen[other] == point:
                continue
            if _holds(points, corners, infinite, other, point):
                seen[other] = point
                cavity[holes] = other
                holes += 1
            else:
                rim[edges, 0] = corners[triangle, (k + 1) % 3]
                rim[edges, 1] = corners[triangle, (k + 2) % 3]
                rim[edges, 2] = other
                rim[edges, 3] = triangle
                edges += 1
    return holes, edges


@njit(cache=True, nogil=True)
def _holds(
    points: NDArray[np.int64],
    corners: NDArray[np.int64],
    infinite: int,
    triangle: int,
    point: int,
) -> Any:
    """Return whether the circle of a triangle holds the point; to infinity it is a half-plane."""
    for k in range(3):
        if corners[triangle, k] == infinite:
            a, b = corners[triangle, (k + 1) % 3], corners[triangle, (k + 2) % 3]
            turn = _turn(points, a, b, point)
            if turn != 0:
                return turn > 0
            ax, ay = points[a, 0] - points[point, 0], points[a, 1] - points[point, 1]
            bx, by = points[b, 0] - points[point, 0], points[b, 1] - points[point, 1]
            return ax * bx + ay * by < 0
    px, py = points[point]
    ax, ay = points[corners[triangle, 0], 0] - px, points[corners[triangle, 0], 1] - py
    bx, by = points[corners[triangle, 1], 0] - px, points[corners[triangle, 1], 1] - py
    cx, cy = points[corners[triangle, 2], 0] - px, points[corners[triangle, 2], 1] - py
    return (
        (ax * ax + ay * ay) * (bx * cy - by * cx)
        + (bx * bx + by * by) * (cx * ay - cy * ax)
        + (cx * cx + cy * cy) * (ax * by - ay * bx)
    ) > 0
