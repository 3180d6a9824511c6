"""Nelder-Mead with the objective outside: it asks for a point and is sent what was found there."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Point = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """What the objective costs at the point where it was really evaluated."""

    point: Point
    cost: float


Search = Generator[Point, Evaluation, Evaluation]


def nelder_mead(
    simplex: Iterable[Point],
    *,
    point_spread: float,
    cost_spread: float,
    known: Iterable[Evaluation] = (),
) -> Search:
    """Ask for points until the simplex is small; return its best corner.

    `simplex` and what is already `known` are N + 1 corners of N coordinates. The search ends when
    no corner is farther than `point_spread` from the best in any coordinate and none costs more
    than `cost_spread` above it. Coefficients 1, 2, 0.5 and 0.5 (Nelder and Mead 1965); on an
    objective that does not change, the points are those of `scipy.optimize.minimize`. An Evaluation
    may lie beside the point asked for: the simplex moves to where it was really evaluated.
    """
    corners = list(known)
    for point in simplex:
        corners.append((yield point))
    while True:
        corners.sort(key=_cost)
        best, worst = corners[0], corners[-1]
        if _is_small(corners, point_spread, cost_spread):
            return best
        centre = np.add.reduce([corner.point for corner in corners[:-1]]) / (len(corners) - 1)
        reflected = yield 2 * centre - worst.point
        if reflected.cost < best.cost:
            expanded = yield 3 * centre - 2 * worst.point
            corners[-1] = expanded if expanded.cost < reflected.cost else reflected
        elif reflected.cost < corners[-2].cost:
            corners[-1] = reflected
        elif reflected.cost < worst.cost:
            outside = yield 1.5 * centre - 0.5 * worst.point
            if outside.cost <= reflected.cost:
                corners[-1] = outside
            else:
                corners = yield from _shrink(corners)
        else:
            inside = yield 0.5 * centre + 0.5 * worst.point
            if inside.cost < worst.cost:
                corners[-1] = inside
            else:
                corners = yield from _shrink(corners)


def _shrink(corners: list[Evaluation]) -> Generator[Point, Evaluation, list[Evaluation]]:
    """Move every corner half-way to the best."""
    best, shrunk = corners[0], [corners[0]]
    for corner in corners[1:]:
        shrunk.append((yield best.point + 0.5 * (corner.point - best.point)))
    return shrunk


def _is_small(corners: list[Evaluation], point_spread: float, cost_spread: float) -> bool:
    best = corners[0]
    return all(
        np.abs(corner.point - best.point).max() <= point_spread
        and corner.cost - best.cost <= cost_spread
        for corner in corners[1:]
    )


def _cost(evaluation: Evaluation) -> float:
    return evaluation.cost
