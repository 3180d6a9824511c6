"""What a run says in one sentence, and what it does not say."""

from __future__ import annotations

from collections.abc import Mapping

from rig.evaluation.report.wording import failed, labels, number
from rig.evaluation.statistics import BLIND_BELOW, WARM_UP_PAIRS, InlierStatistics
from rig.evaluation.summary import SideSummary, Summary


def verdict(summary: Summary) -> str:
    """Return the run's outcome in ORB inliers, with the numbers; never a claim of significance.

    One run is one drive: however many pictures it has, it is one sample of the difference.
    """
    return " ".join([*failures(summary.left, summary.right), _outcome(summary)])


def failures(*sides: SideSummary) -> list[str]:
    """Return a sentence for each controller that failed on pictures, and so did not drive."""
    return [f"{failed(side.controller, side.held)}." for side in sides if side.held]


def _outcome(summary: Summary) -> str:
    left, right = summary.left, summary.right
    a, b = left.inliers["orb"], right.inliers["orb"]
    if a.median is None or b.median is None:
        return (
            f"Nothing was counted: the first {WARM_UP_PAIRS} pairs are warm-up, and no two "
            f"neighbouring complete pairs follow them in these {len(summary.series)}."
        )
    left_label, right_label = labels(left.controller, right.controller)
    inliers = _inliers(left_label, a, right_label, b)
    if left.controller == right.controller:
        return (
            f"Control run: {left.controller} drove both cameras. {inliers} "
            "What differs is the cameras' doing, not the controller's."
        )
    return f"On this drive {inliers}"


def _inliers(left: str, a: InlierStatistics, right: str, b: InlierStatistics) -> str:
    assert a.median is not None
    assert b.median is not None
    times = f" ({a.median / b.median:.2f} ×)" if b.median > 0 else ""
    return (
        f"{left} had a median of {number(a.median)} ORB inliers against {number(b.median)} for "
        f"{right}{times}, and at worst {number(a.min)} against {number(b.min)}. "
        f"{_blindness(left, a, right, b)}"
    )


def _blindness(left: str, a: InlierStatistics, right: str, b: InlierStatistics) -> str:
    limit = f"fewer than {BLIND_BELOW['orb']} inliers"
    if a.blind_frames == b.blind_frames == 0:
        return f"Neither was ever blind ({limit})."
    return f"Blind pictures ({limit}): {left} {a.blind_frames}, {right} {b.blind_frames}."


def nearness(summary: Summary) -> str | None:
    """Return which share of the bound both reached, in a sentence; None where it is not known."""
    left, right = summary.of_ceiling("left"), summary.of_ceiling("right")
    if summary.ceiling is None or left is None or right is None:
        return None
    left_label, right_label = labels(summary.left.controller, summary.right.controller)
    best = summary.ceiling
    return (
        f"The best paths that know the future (rig bound) have a median of {best.best_median} and "
        f"a minimum of {best.best_min} ORB inliers: {left_label} reached {shares_text(left)}, "
        f"{right_label} {shares_text(right)}."
    )


def shares_text(shares: Mapping[str, float | None]) -> str:
    """Return shares of the bound as words."""
    median, least = (number(shares[key], 0) for key in ("median_pct", "min_pct"))
    return f"{median} % of the median and {least} % of the minimum"
