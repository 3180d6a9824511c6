"""How near a drive came to the best that a grid of settings allows there."""

from __future__ import annotations

from dataclasses import dataclass

from rig.evaluation.statistics import InlierStatistics

Shares = dict[str, float | None]


@dataclass(frozen=True, slots=True)
class Ceiling:
    """The best median and the best minimum of ORB inliers on a drive, as `rig bound` found them."""

    best_median: int
    best_min: int

    def shares(self, reached: InlierStatistics) -> Shares:
        """Return `median_pct` and `min_pct` of the best; None where nothing can be divided."""
        return {
            "median_pct": _percent(reached.median, self.best_median),
            "min_pct": _percent(reached.min, self.best_min),
        }


def _percent(reached: float | None, best: int) -> float | None:
    return None if reached is None or best <= 0 else 100 * reached / best
