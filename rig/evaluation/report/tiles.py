"""The few numbers that a run is remembered by, as bars to compare at a glance."""

from __future__ import annotations

from dataclasses import dataclass

from rig.evaluation.odometry import processed_pct
from rig.evaluation.report.wording import number
from rig.evaluation.statistics import BLIND_BELOW, WARM_UP_PAIRS
from rig.evaluation.summary import RACE_SIDES, RaceSide, SideSummary, Summary


@dataclass(frozen=True, slots=True)
class Bar:
    """One side's number: its text, and its length in per cent of the longest of the tile."""

    side: RaceSide
    text: str
    length_pct: float


@dataclass(frozen=True, slots=True)
class Tile:
    """One quantity of both sides; `note` says which way is better."""

    title: str
    note: str
    bars: tuple[Bar, ...]


def tiles(summary: Summary) -> list[Tile]:
    """Return the tiles of a run: median and least ORB inliers, blind pictures, share that moved."""
    orb = [side.inliers["orb"] for side in (summary.left, summary.right)]
    if any(statistics.median is None for statistics in orb):
        return []
    shown = [
        _tile("Median inliers", "ORB, higher is better", [side.median for side in orb]),
        _tile("Worst moment", "fewest ORB inliers, higher is better", [side.min for side in orb]),
        _tile(
            "Blind pictures",
            f"under {BLIND_BELOW['orb']} ORB inliers, lower is better",
            [side.blind_frames for side in orb],
        ),
    ]
    moved = [_processed(side) for side in (summary.left, summary.right)]
    if any(share is not None for share in moved):
        note = "by viso2-style odometry, higher is better"
        shown.append(_tile("Pictures that told the motion", note, moved, unit=" %"))
    return shown


def _processed(side: SideSummary) -> float | None:
    return processed_pct(side.odometry.since(WARM_UP_PAIRS)) if side.odometry is not None else None


def _tile(title: str, note: str, values: list[float | None], unit: str = "") -> Tile:
    longest = max([value or 0.0 for value in values] + [1e-9])
    return Tile(
        title,
        note,
        tuple(
            Bar(side, number(value) + unit, round(100 * (value or 0.0) / longest, 1))
            for side, value in zip(RACE_SIDES, values, strict=True)
        ),
    )
