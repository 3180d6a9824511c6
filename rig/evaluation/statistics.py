"""The numbers that a run is told by: medians, minima, percentiles and blind frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

Column = NDArray[np.float64]

WARM_UP_PAIRS = 10
"""Triggers 0..9 are recorded and not counted: a controller may first find its place."""

BLIND_BELOW: Mapping[str, int] = {"orb": 20, "viso2": 10}
"""Under this many inliers a picture is blind; chance alone gives a handful (front end -> n)."""


@dataclass(frozen=True, slots=True)
class InlierStatistics:
    """Inliers over the counted moments of a run; all None, and 0 blind, when none is counted.

    `p5` is the 5th percentile, interpolated linearly.
    """

    median: float | None
    min: int | None
    mean: float | None
    p5: float | None
    blind_frames: int


def counted(trigger: NDArray[np.int64], values: Column) -> Column:
    """Return the values after the warm-up (trigger >= 10) that exist (are not NaN).

    A value belongs to its own trigger: the first inlier count kept is that between the pictures
    of triggers 9 and 10.
    """
    return values[(trigger >= WARM_UP_PAIRS) & ~np.isnan(values)]


def inlier_statistics(counts: Column, blind_below: int) -> InlierStatistics:
    """Return the statistics of counted inliers; `blind_below` is in inliers."""
    if counts.size == 0:
        return InlierStatistics(None, None, None, None, 0)
    return InlierStatistics(
        median=float(np.median(counts)),
        min=int(counts.min()),
        mean=float(counts.mean()),
        p5=float(np.percentile(counts, 5)),
        blind_frames=int(np.count_nonzero(counts < blind_below)),
    )


def spread(values: Column) -> tuple[float | None, float | None, float | None]:
    """Return (lowest, median, highest), or Nones for no values."""
    if values.size == 0:
        return (None, None, None)
    return (float(values.min()), float(np.median(values)), float(values.max()))


def latency(values_ms: Column) -> dict[str, float | None]:
    """Return the 50th and 99th percentile in milliseconds under `p50` and `p99`."""
    if values_ms.size == 0:
        return {"p50": None, "p99": None}
    p50, p99 = np.percentile(values_ms, (50, 99))
    return {"p50": float(p50), "p99": float(p99)}


def interval95(draws: Column, runs: int) -> list[float]:
    """Return the ends between which a mean over `runs` >= 2 runs lies, from its bootstrap draws.

    The percentile interval, widened as Student's interval is wider than the normal one for few
    runs (Hesterberg, The American Statistician 69, 2015): draws from few runs spread too little.
    """
    below = float(ndtr(np.sqrt(runs / (runs - 1)) * stdtrit(runs - 1, 0.025)))
    low, high = np.quantile(draws, (below, 1 - below))
    return [float(low), float(high)]
