"""The search asks for exactly the points at which scipy evaluates."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import minimize

from rig.controllers.search import Evaluation, nelder_mead

Array = NDArray[np.float64]
COORDINATE = st.floats(-3, 3)


def rosenbrock(x: Array) -> float:
    return float((1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2)


def stairs(x: Array) -> float:
    """An objective with ties, on which contractions and shrinking happen."""
    return float(np.floor(4 * np.abs(x)).sum())


def trace(
    objective: Callable[[Array], float], simplex: Array, points_max: int
) -> tuple[Array, Evaluation | None]:
    search = nelder_mead(simplex, point_spread=1e-4, cost_spread=1e-4)
    points: list[Array] = []
    point = next(search)
    try:
        while len(points) < points_max:
            points.append(point.copy())
            point = search.send(Evaluation(point, objective(point)))
    except StopIteration as stop:
        return np.array(points), stop.value
    return np.array(points), None


def scipy_trace(objective: Callable[[Array], float], simplex: Array, points_max: int) -> Array:
    points: list[Array] = []

    def observed(x: Array) -> float:
        points.append(x.copy())
        return objective(x)

    options = {
        "initial_simplex": simplex,
        "xatol": 1e-4,
        "fatol": 1e-4,
        "maxfev": points_max,
        "maxiter": points_max,
    }
    minimize(observed, simplex[0], method="Nelder-Mead", options=options)
    return np.array(points)


def test_rosenbrock_is_searched_as_scipy_does() -> None:
    simplex = np.array([[-1.2, 1.0], [-1.0, 1.0], [-1.2, 1.3]])
    points, best = trace(rosenbrock, simplex, 1_000)
    assert np.array_equal(points, scipy_trace(rosenbrock, simplex, 1_000))
    assert best is not None
    assert best.point == pytest.approx([1, 1], abs=1e-3)


@settings(deadline=None, max_examples=60)
@given(
    st.sampled_from([rosenbrock, stairs]),
    st.lists(COORDINATE, min_size=6, max_size=6).map(lambda x: np.array(x).reshape(3, 2)),
)
def test_any_simplex_is_searched_as_scipy_does(
    objective: Callable[[Array], float], simplex: Array
) -> None:
    points, _ = trace(objective, simplex, 200)
    assert np.array_equal(points, scipy_trace(objective, simplex, 200))


def test_the_simplex_moves_to_where_the_objective_was_evaluated() -> None:
    search = nelder_mead(np.eye(3, 2), point_spread=1e-4, cost_spread=1e-4)
    next(search)
    for beside, cost in (((1.0, 0.5), 3.0), ((0.0, 1.0), 2.0), ((0.0, 0.0), 1.0)):
        point = search.send(Evaluation(np.array(beside), cost))
    assert point.tolist() == [-1.0, 0.5]
