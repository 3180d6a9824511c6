"""Many runs told as one: averages by controller, and rivals compared run by run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.evaluation.statistics import interval95

SCHEMA = "rig.evaluation/1"
FRONT_ENDS = ("orb", "viso2")
RESAMPLES = 10_000

RunJson = Mapping[str, Any]


def aggregate(runs: Sequence[RunJson], *, seed: int = 0) -> dict[str, Any]:
    """Return the content of evaluation.json (schema rig.evaluation/1) for summaries of runs.

    `by_controller` averages each statistic over every time that a controller drove a camera (as
    tables 5.3 and 5.4 of the thesis do); `runs` counts the recordings that it drove in, and
    `of_bound` averages over those whose bound is known. `paired` compares the two controllers of
    each recording; see `paired`. `seed` draws the resamples.
    """
    return {
        "schema": SCHEMA,
        "runs": list(runs),
        "by_controller": {name: _average(runs, name) for name in _controllers(runs)},
        "paired": {
            f"{a} vs {b}": compare(duels, seed=seed) for (a, b), duels in _duels(runs).items()
        },
    }


def score(controller: str, paired: Mapping[str, Any]) -> tuple[int, int]:
    """Return how many runs a controller won and lost against all its rivals in `paired`."""
    won = lost = 0
    for pair, result in paired.items():
        a, _, b = pair.partition(" vs ")
        if a == b:
            continue
        won += result["wins"] * (a == controller) + result["losses"] * (b == controller)
        lost += result["losses"] * (a == controller) + result["wins"] * (b == controller)
    return won, lost


@dataclass(frozen=True, slots=True)
class Duel:
    """ORB statistics of one run of two controllers, a and b."""

    median: tuple[float, float]
    min: tuple[float, float]


def compare(duels: Sequence[Duel], *, seed: int) -> dict[str, Any]:
    """Return how a did against b over runs in which they drove side by side.

    A ratio is a's average over the runs by b's, so a single blind run of b does not divide by
    zero; None when b's average is 0. `ci95` is the bootstrap interval of the median's ratio
    when whole runs are resampled with replacement (frames of one run depend on each other, runs
    do not), see `interval95`. It is None for one run: one run shows no significance. A win is a
    run in which a's median is higher; equal medians are neither won nor lost.
    """
    medians = np.array([duel.median for duel in duels], np.float64).reshape(-1, 2)
    minima = np.array([duel.min for duel in duels], np.float64).reshape(-1, 2)
    return {
        "orb_median_ratio": ratio_of_means(medians),
        "orb_min_ratio": ratio_of_means(minima),
        "ci95": ratio_ci95(medians, seed),
        "wins": int(np.count_nonzero(medians[:, 0] > medians[:, 1])),
        "losses": int(np.count_nonzero(medians[:, 0] < medians[:, 1])),
    }


def ratio_of_means(values: NDArray[np.float64]) -> float | None:
    """Return the mean of the first of two columns by that of the second; None for one of 0."""
    a, b = values.sum(axis=0) if values.size else (0.0, 0.0)
    return float(a / b) if b > 0 else None


def ratio_ci95(values: NDArray[np.float64], seed: int) -> list[float] | None:
    """Return the bootstrap interval of `ratio_of_means` when rows are drawn with replacement.

    None for less than two rows, which show no significance, and where a draw divides by 0.
    """
    runs = len(values)
    if runs < 2:
        return None
    draws = np.random.default_rng(seed).integers(runs, size=(RESAMPLES, runs))
    sums = values[draws].sum(axis=1)
    if not (sums[:, 1] > 0).all():
        return None
    return interval95(sums[:, 0] / sums[:, 1], runs)


def _sides(run: RunJson) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    return run["left"], run["right"]


def _controllers(runs: Sequence[RunJson]) -> Iterable[str]:
    """Return each controller's name once, in order of appearance."""
    return dict.fromkeys(side["controller"] for run in runs for side in _sides(run))


def _average(runs: Sequence[RunJson], controller: str) -> dict[str, Any]:
    driven = [[side for side in _sides(run) if side["controller"] == controller] for run in runs]
    sides = [side for run in driven for side in run]
    averages: dict[str, Any] = {}
    for front_end in FRONT_ENDS:
        statistics = [side[front_end] for side in sides if front_end in side]
        if statistics:
            averages[front_end] = {key: _mean(statistics, key) for key in statistics[0]}
    near = [side["of_bound"] for side in sides if "of_bound" in side]
    if near:
        averages["of_bound"] = {key: _mean(near, key) for key in near[0]} | {"runs": len(near)}
    return {**averages, "runs": sum(1 for run in driven if run)}


def _mean(statistics: Sequence[Mapping[str, float | None]], key: str) -> float | None:
    values = [value for entry in statistics if (value := entry[key]) is not None]
    return sum(values) / len(values) if values else None


def _duels(runs: Sequence[RunJson]) -> dict[tuple[str, str], list[Duel]]:
    """Return the duels of each two controllers, in the order in which they first met.

    A run in which nothing was counted, or ORB did not run, is no duel.
    """
    duels: dict[tuple[str, str], list[Duel]] = {}
    for run in runs:
        left, right = _sides(run)
        if any(side.get("orb", {}).get("median") is None for side in (left, right)):
            continue
        names = left["controller"], right["controller"]
        if names not in duels and names[::-1] in duels:
            left, right, names = right, left, names[::-1]
        duels.setdefault(names, []).append(
            Duel(
                (left["orb"]["median"], right["orb"]["median"]),
                (left["orb"]["min"], right["orb"]["min"]),
            )
        )
    return duels
