"""How much better one controller's pictures are than its rival's, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.evaluation.aggregate import FRONT_ENDS
from rig.evaluation.statistics import counted, interval95
from rig.evaluation.summary import RACE_SIDES, Summary

Array = NDArray[np.float64]

BLOCK_PAIRS = 10
"""Neighbouring pairs look alike: they are resampled together, a second of the usual drive."""

RESAMPLES = 4_000


def differences(summaries: Sequence[Summary], *, seed: int = 0) -> dict[str, Any]:
    """Return per two controllers and front end how many inliers more the first one had.

    {"a vs b": {front end: {"runs", "mean": {"difference", "ci95"}, "min": {...}}}}. A difference
    is the mean over the runs in which both drove side by side. `ci95` is its bootstrap interval,
    see `mean_difference` and `min_difference`; None for one run, which shows no significance.
    """
    told: dict[str, Any] = {}
    for (a, b), duels in _duels(summaries).items():
        told[f"{a} vs {b}"] = {
            name: {
                "runs": len(runs),
                "mean": mean_difference(runs, seed=seed),
                "min": min_difference(runs, seed=seed),
            }
            for name in FRONT_ENDS
            if (runs := [duel[name] for duel in duels if name in duel])
        }
    return told


def mean_difference(runs: Sequence[Array], *, seed: int) -> dict[str, Any]:
    """Return how many inliers more the first side had at the same moment, and the ci95.

    The mean over runs (N x 2 paired counts each) of each run's mean. Whole runs are drawn with
    replacement, and in each drawn run moving blocks of BLOCK_PAIRS neighbouring pairs. A block
    comes from at most one block's length away (the local block bootstrap of Paparoditis and
    Politis, 2002): a drive through a tunnel is not alike everywhere, and every draw must have its
    dark stretch. Means are compared and not medians: where half of a drive is dark, the median
    of a draw falls on either side of the gap.
    """
    rng = np.random.default_rng(seed)
    apart = [run[:, 0] - run[:, 1] for run in runs]
    found = float(np.mean([values.mean() for values in apart]))
    if len(runs) < 2:
        return {"difference": found, "ci95": None}
    within = np.stack([values[_block_rows(len(values), rng)].mean(axis=1) for values in apart])
    chosen = rng.integers(len(runs), size=(RESAMPLES, len(runs)))
    drawn = within[chosen, rng.integers(RESAMPLES, size=chosen.shape)]
    return {"difference": found, "ci95": interval95(drawn.mean(axis=1), len(runs))}


def min_difference(runs: Sequence[Array], *, seed: int) -> dict[str, Any]:
    """Return the mean difference of minima over runs and its ci95, from whole runs alone.

    A part of a run knows nothing of the whole run's minimum.
    """
    apart = np.array([run[:, 0].min() - run[:, 1].min() for run in runs], np.float64)
    if len(runs) < 2:
        return {"difference": float(apart.mean()), "ci95": None}
    chosen = np.random.default_rng(seed).integers(len(runs), size=(RESAMPLES, len(runs)))
    return {
        "difference": float(apart.mean()),
        "ci95": interval95(apart[chosen].mean(axis=1), len(runs)),
    }


def _block_rows(rows: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return RESAMPLES x rows indices: blocks of neighbours from nearby, one after another.

    The end of a run is followed by its beginning, so that every row is drawn equally often.
    """
    length = min(BLOCK_PAIRS, rows)
    places = np.arange(0, rows, length)
    starts = places + rng.integers(-length, length + 1, size=(RESAMPLES, len(places)))
    blocks = starts[:, :, None] + np.arange(length)
    return np.asarray(blocks.reshape(RESAMPLES, -1)[:, :rows] % rows)


def _duels(summaries: Sequence[Summary]) -> dict[tuple[str, str], list[dict[str, Array]]]:
    """Return the counts of each two controllers, in the order in which they first met.

    A run in which nothing was counted is no duel.
    """
    duels: dict[tuple[str, str], list[dict[str, Array]]] = {}
    for summary in summaries:
        names, sides = (summary.left.controller, summary.right.controller), RACE_SIDES
        if names not in duels and names[::-1] in duels:
            names, sides = names[::-1], sides[::-1]
        trigger = summary.series.trigger
        columns = [summary.camera(side).inliers for side in sides]
        counts = {
            name: np.column_stack([counted(trigger, column[name]) for column in columns])
            for name in columns[0]
        }
        if any(len(column) for column in counts.values()):
            duels.setdefault(names, []).append(counts)
    return duels
