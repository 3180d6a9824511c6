"""What a run says in one sentence, and what it does not say."""

from __future__ import annotations

from rig.evaluation.statistics import BLIND_BELOW, WARM_UP_PAIRS, InlierStatistics
from rig.evaluation.summary import Summary


def verdict(summary: Summary) -> str:
    """Return the run's outcome in ORB inliers, with the numbers; never a claim of significance.

    One run is one drive: however many pictures it has, it is one sample of the difference.
    """
    left, right = summary.left, summary.right
    a, b = left.inliers["orb"], right.inliers["orb"]
    if a.median is None or b.median is None or a.min is None or b.min is None:
        return (
            f"Nothing was counted: the first {WARM_UP_PAIRS} pairs are warm-up, and no two "
            f"neighbouring complete pairs follow them in these {len(summary.series)}."
        )
    numbers = (
        f"a median of {_number(a.median)} ORB inliers against {_number(b.median)}"
        f"{_times(a.median, b.median)}, and at worst {a.min} against {b.min}"
    )
    if left.controller == right.controller:
        return (
            f"Control run: {left.controller} drove both cameras. The left kept {numbers}. "
            "What differs here is the cameras' doing, not the controller's."
        )
    return (
        f"On this drive {left.controller} kept {numbers} for {right.controller}; "
        f"{_blindness(left.controller, a, right.controller, b)}"
    )


def caution(summary: Summary) -> str:
    """Return why one run settles nothing, and what to do about it."""
    left, right = summary.left.controller, summary.right.controller
    return (
        "One run is one sample: it cannot show that either controller is better. "
        f"Drive several seeds and both wirings: rig race {left} {right} --seeds 1-20."
    )


def _blindness(left: str, a: InlierStatistics, right: str, b: InlierStatistics) -> str:
    limit = f"fewer than {BLIND_BELOW['orb']} inliers"
    if a.blind_frames == b.blind_frames == 0:
        return f"neither was ever blind ({limit})."
    return (
        f"{left} was blind ({limit}) in {a.blind_frames} and {right} in "
        f"{b.blind_frames} counted pictures."
    )


def _times(a: float, b: float) -> str:
    return f" ({a / b:.2f} ×)" if b > 0 else ""


def _number(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")
