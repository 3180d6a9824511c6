"""The way that odometry told, seen from above, over the true one where it is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.evaluation.odometry import Odometry, align
from rig.evaluation.report.wording import number
from rig.evaluation.statistics import WARM_UP_PAIRS
from rig.evaluation.summary import RACE_SIDES, Summary

Array = NDArray[np.float64]

WIDTH, MARGIN = 480.0, 16.0
TALLEST, FLATTEST = 300.0, 110.0


@dataclass(frozen=True, slots=True)
class Way:
    """A line on the map: whose (left, right or truth), and SVG path data."""

    whose: str
    path: str


@dataclass(frozen=True, slots=True)
class Map:
    """An SVG map: its size, its lines, and a scale bar."""

    ways: list[Way]
    width: float
    height: float
    bar_px: float
    bar_label: str
    true: bool


def ways(summary: Summary) -> Map | None:
    """Return the map of a run; None where no way of at least three places was told.

    With the true way known, the told ones are turned, shifted and scaled to it as for the absolute
    trajectory error. The drive begins at the left.
    """
    told = {
        side: odometry
        for side in RACE_SIDES
        if (odometry := summary.camera(side).odometry) and len(odometry.way(WARM_UP_PAIRS)) >= 3
    }
    if not told:
        return None
    truth = next(iter(told.values())).truth.since(WARM_UP_PAIRS - 1)
    lines: dict[str, Array] = {}
    if len(truth) >= 3:
        lines["truth"] = truth.positions[:, :2]
    for side, way in told.items():
        if (line := _line(way)) is not None:
            lines[side] = line
    if not lines:
        return None
    flat = _turned(lines)
    low = np.min([line.min(axis=0) for line in flat.values()], axis=0)
    high = np.max([line.max(axis=0) for line in flat.values()], axis=0)
    scale = min((WIDTH - 2 * MARGIN) / max(high[0] - low[0], 1e-6), TALLEST / _size(low, high))
    height = max(scale * float(high[1] - low[1]) + 2 * MARGIN, FLATTEST)
    centre = (low + high) / 2
    middle = np.array([WIDTH / 2, height / 2])
    bar_m = _round_below(100 / scale)
    return Map(
        ways=[
            Way(whose, _path((line - centre) * (scale, -scale) + middle))
            for whose, line in flat.items()
        ],
        width=WIDTH,
        height=round(height, 1),
        bar_px=round(bar_m * scale, 1),
        bar_label=f"{number(bar_m)} m",
        true="truth" in lines,
    )


def _size(low: Array, high: Array) -> float:
    return max(float(high[1] - low[1]), 1e-6)


def _line(way: Odometry) -> Array | None:
    """Return a way from above, N x 2: on the true one's ground, or the first camera's."""
    estimated = way.way(WARM_UP_PAIRS)
    if len(way.truth) < 3:
        return estimated.positions[:, [2, 0]] * (1, -1)
    shared = np.intersect1d(estimated.triggers, way.truth.triggers)
    both = [side.only(shared).positions for side in (estimated, way.truth)]
    found = align(*both) if len(shared) >= 3 else None
    if found is None:
        return None
    scale, rotation, shift = found
    return np.asarray((scale * both[0] @ rotation.T + shift)[:, :2])


def _turned(lines: dict[str, Array]) -> dict[str, Array]:
    """Return all lines turned so that the first one runs from left to right."""
    first = next(iter(lines.values()))
    x, y = first[-1] - first[0]
    length = np.hypot(x, y) or 1.0
    turn = np.array([[x, -y], [y, x]]) / length
    return {whose: line @ turn for whose, line in lines.items()}


def _path(points: Array) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)


def _round_below(metres: float) -> float:
    """Return 1, 2 or 5 times a power of ten, as large as fits."""
    power = 10.0 ** np.floor(np.log10(max(metres, 1e-9)))
    return float(next(step * power for step in (5, 2, 1) if step * power <= metres * 1.0001))
