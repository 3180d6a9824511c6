"""How much better one controller's pictures are than its rival's, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.evaluation.aggregate import FRONT_ENDS
from rig.evaluation.statistics import counted
from rig.evaluation.summary import RACE_SIDES, Summary

Array = NDArray[np.float64]

BLOCK_PAIRS = 10
"""Neighbouring pairs look alike: they are resampled together, a second of the usual drive."""

RESAMPLES = 2_000


def differences(summaries: Sequence[Summary], *, seed: int = 0) -> dict[str, Any]:
    """Return per two controllers and front end how many inliers more the first one had.

    {"a vs b": {front end: {"runs", "median": {"difference", "ci95"}, "min": {...}}}}. A difference
    is the mean over the runs in which both drove side by side. `ci95` is its bootstrap interval,
    see `median_difference` and `min_difference`; None for one run, which shows no significance.
    """
    told: dict[str, Any] = {}
    for (a, b), duels in _duels(summaries).items():
        told[f"{a} vs {b}"] = {
            name: {
                "runs": len(runs),
                "median": median_difference(runs, seed=seed),
                "min": min_difference(runs, seed=seed),
            }
            for name in FRONT_ENDS
            if (runs := [duel[name] for duel in duels if len(duel.get(name, ()))])
        }
    return told


def median_difference(runs: Sequence[Array], *, seed: int) -> dict[str, Any]:
    """Return the mean difference of medians over runs (N x 2 paired counts each) and its ci95.

    Whole runs are drawn with replacement, and in each drawn run moving blocks of BLOCK_PAIRS
    neighbouring pairs (Kuensch, 1989), both sides together, as light and place are the same.
    """
    rng = np.random.default_rng(seed)
    found = float(np.mean([_medians_apart(run[None])[0] for run in runs]))
    if len(runs) < 2:
        return {"difference": found, "ci95": None}
    within = np.stack([_medians_apart(run[_block_rows(len(run), rng)]) for run in runs])
    chosen = rng.integers(len(runs), size=(RESAMPLES, len(runs)))
    drawn = within[chosen, rng.integers(RESAMPLES, size=chosen.shape)]
    return {"difference": found, "ci95": _middle(drawn.mean(axis=1))}


def min_difference(runs: Sequence[Array], *, seed: int) -> dict[str, Any]:
    """Return the mean difference of minima over runs and its ci95, from whole runs alone.

    A part of a run knows nothing of the whole run's minimum.
    """
    apart = np.array([run[:, 0].min() - run[:, 1].min() for run in runs], np.float64)
    if len(runs) < 2:
        return {"difference": float(apart.mean()), "ci95": None}
    chosen = np.random.default_rng(seed).integers(len(runs), size=(RESAMPLES, len(runs)))
    return {"difference": float(apart.mean()), "ci95": _middle(apart[chosen].mean(axis=1))}


def _medians_apart(counts: Array) -> Array:
    """Return the difference of both columns' medians for each of M x N x 2."""
    medians = np.median(counts, axis=1)
    return np.asarray(medians[:, 0] - medians[:, 1])


def _block_rows(rows: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return RESAMPLES x rows indices: blocks of neighbours from anywhere, one after another."""
    length = min(BLOCK_PAIRS, rows)
    blocks = -(-rows // length)
    starts = rng.integers(rows - length + 1, size=(RESAMPLES, blocks, 1))
    return np.asarray((starts + np.arange(length)).reshape(RESAMPLES, -1)[:, :rows])


def _middle(draws: Array) -> list[float]:
    low, high = np.percentile(draws, (2.5, 97.5))
    return [float(low), float(high)]


def _duels(summaries: Sequence[Summary]) -> dict[tuple[str, str], list[dict[str, Array]]]:
    """Return the counts of each two controllers, in the order in which they first met."""
    duels: dict[tuple[str, str], list[dict[str, Array]]] = {}
    for summary in summaries:
        names, sides = (summary.left.controller, summary.right.controller), RACE_SIDES
        if names[::-1] in duels:
            names, sides = names[::-1], sides[::-1]
        trigger = summary.series.trigger
        columns = [summary.camera(side).inliers for side in sides]
        duels.setdefault(names, []).append(
            {
                name: np.column_stack([counted(trigger, column[name]) for column in columns])
                for name in columns[0]
            }
        )
    return duels
