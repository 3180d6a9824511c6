"""summary.json: what a run came to, in the keys that others script against."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from rig.core.types import SIDES, Pair, PairRecord, Side
from rig.evaluation.ceiling import Ceiling, Shares
from rig.evaluation.front_ends import FRONT_ENDS, FrontEnds
from rig.evaluation.odometry import Odometry, mean_inlier_pct, processed_pct
from rig.evaluation.segments import KINDS, Kind, Segment, kinds_by_row, light_level, segments
from rig.evaluation.series import CameraSeries, Column, RunSeries, measure
from rig.evaluation.statistics import (
    BLIND_BELOW,
    WARM_UP_PAIRS,
    InlierStatistics,
    counted,
    inlier_statistics,
    latency,
    spread,
)
from rig.record.header import RunHeader

T = TypeVar("T")

RaceSide = Literal["left", "right"]
RACE_SIDES: tuple[RaceSide, RaceSide] = ("left", "right")

SCHEMA = "rig.summary/1"

Spread = tuple[float | None, float | None, float | None]


class Recorded(Protocol):
    """A run that can be read back: `rig.record.reader.Recording`, or one in memory."""

    @property
    def header(self) -> RunHeader:
        """Return what the run was."""
        ...

    def records(self) -> Iterator[PairRecord]:
        """Return the records in order, from the first at every call."""
        ...


@dataclass(frozen=True, slots=True)
class SegmentSummary:
    """One controller's inliers over the counted rows of one kind of light."""

    pairs: int
    inliers: Mapping[str, InlierStatistics]

    def as_json(self) -> dict[str, Any]:
        """Return the object under `segments` and the kind's name."""
        front_ends = {name: asdict(statistics) for name, statistics in self.inliers.items()}
        return {"pairs": self.pairs, **front_ends}


@dataclass(frozen=True, slots=True)
class SideSummary:
    """One controller's part in a run.

    `inliers` maps each front end that ran to its statistics; `exposure_us` and `gain_db` are
    (lowest, median, highest) of what was used; `decision_ms` holds p50 and p99. `segments` maps
    the kinds of light that the drive had to their statistics. `odometry` is there when the
    viso2-style front end ran. `held` is on how many pictures, of all that came, the controller
    failed, so that its last settings held.
    """

    controller: str
    inliers: Mapping[str, InlierStatistics]
    exposure_us: Spread
    gain_db: Spread
    decision_ms: Mapping[str, float | None]
    segments: Mapping[Kind, SegmentSummary]
    odometry: Odometry | None = None
    held: int = 0

    def as_json(self) -> dict[str, Any]:
        """Return the object under `left` or `right` in summary.json."""
        front_ends = {name: asdict(statistics) for name, statistics in self.inliers.items()}
        told: dict[str, Any] = {}
        if self.odometry is not None:
            steps = self.odometry.since(WARM_UP_PAIRS)
            front_ends["viso2"] |= {
                "frames_processed_pct": processed_pct(steps),
                "mean_inlier_pct": mean_inlier_pct(steps),
            }
            told = {"odometry": self.odometry.as_json(since=WARM_UP_PAIRS)}
        return {
            "controller": self.controller,
            **front_ends,
            **told,
            "exposure_us": list(self.exposure_us),
            "gain_db": list(self.gain_db),
            "decision_ms": dict(self.decision_ms),
            "held": self.held,
            "segments": {kind: part.as_json() for kind, part in self.segments.items()},
        }


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """A run's header, its columns, and what they come to; `segments` are of rows.

    `left` is the race's first controller: it drives the primary camera, or the secondary when
    the run was swapped; `left_side` says which. `ceiling` is the best that a grid of
    settings allows, where it is known.
    """

    header: RunHeader
    series: RunSeries
    segments: tuple[Segment, ...]
    left_side: Side
    left: SideSummary
    right: SideSummary
    ceiling: Ceiling | None = None

    @property
    def drops(self) -> dict[str, int]:
        """Return how many pairs each cause made incomplete, the most frequent first."""
        return dict(Counter(cause for cause in self.series.cause if cause).most_common())

    @property
    def pairs_complete(self) -> int:
        """Return the number of complete pairs: triggers less all drops."""
        return len(self.series) - sum(self.drops.values())

    def camera(self, side: RaceSide) -> CameraSeries:
        """Return the columns of the camera that the `left` or `right` controller drove."""
        return at(self.series.cameras, self.wired(side))

    def wired(self, side: RaceSide) -> Side:
        """Return which camera the `left` or `right` controller drove."""
        return self.left_side if side == "left" else other(self.left_side)

    def of_ceiling(self, side: RaceSide) -> Shares | None:
        """Return which share of the ceiling a side reached; None where that is not known."""
        told = self.left if side == "left" else self.right
        if self.ceiling is None or "orb" not in told.inliers:
            return None
        return self.ceiling.shares(told.inliers["orb"])

    def as_json(self) -> dict[str, Any]:
        """Return the content of summary.json (schema rig.summary/1)."""
        header = self.header
        shares = {side: self.of_ceiling(side) for side in RACE_SIDES}
        near = {side: {"of_bound": share} if share else {} for side, share in shares.items()}
        return {
            "schema": SCHEMA,
            "command": header.command,
            "cameras": header.cameras,
            "seed": header.seed,
            "world_version": header.world_version,
            "versions": dict(header.versions),
            "frames": len(self.series),
            "pairs_complete": self.pairs_complete,
            "drops": self.drops,
            **({"bound": asdict(self.ceiling)} if self.ceiling else {}),
            "left": self.left.as_json() | near["left"],
            "right": self.right.as_json() | near["right"],
        }


def at(pair: Pair[T], side: Side) -> T:
    """Return the member of a pair that belongs to one camera."""
    return pair[SIDES.index(side)]


def other(side: Side) -> Side:
    """Return the other camera."""
    return SIDES[1 - SIDES.index(side)]


def summarise(recording: Recorded, front_ends: FrontEnds = FRONT_ENDS) -> Summary:
    """Return what a recorded run came to; reads its pictures once, in bounded memory.

    The header's option `swap=true` says that the left controller drove the secondary camera.
    """
    header = recording.header
    series = measure(recording.records(), front_ends, header.intrinsics)
    found = tuple(segments(light_level(series)))
    left_side: Side = "secondary" if header.options.get("swap") == "true" else "primary"
    right_side = other(left_side)
    return Summary(
        header=header,
        series=series,
        segments=found,
        left_side=left_side,
        left=_side(at(header.controllers, left_side), series, found, left_side),
        right=_side(at(header.controllers, right_side), series, found, right_side),
    )


def _side(controller: str, series: RunSeries, found: Sequence[Segment], side: Side) -> SideSummary:
    camera, trigger = at(series.cameras, side), series.trigger
    kinds = np.array(kinds_by_row(found, len(series)), dtype=object)
    parts = {kind: _part(trigger, camera, kinds == kind) for kind in KINDS}
    return SideSummary(
        controller=controller,
        inliers=_statistics(trigger, camera.inliers),
        exposure_us=spread(counted(trigger, camera.exposure_us)),
        gain_db=spread(counted(trigger, camera.gain_db)),
        decision_ms=latency(counted(trigger, camera.decision_ms)),
        segments={kind: part for kind, part in parts.items() if part.pairs},
        odometry=camera.odometry,
        held=sum(word != "" for word in camera.words.get("held", ())),
    )


def _part(
    trigger: NDArray[np.int64], camera: CameraSeries, rows: NDArray[np.bool_]
) -> SegmentSummary:
    counts = {name: column[rows] for name, column in camera.inliers.items()}
    pairs = max((counted(trigger[rows], column).size for column in counts.values()), default=0)
    return SegmentSummary(pairs, _statistics(trigger[rows], counts))


def _statistics(
    trigger: NDArray[np.int64], columns: Mapping[str, Column]
) -> dict[str, InlierStatistics]:
    return {
        name: inlier_statistics(counted(trigger, counts), BLIND_BELOW[name])
        for name, counts in columns.items()
    }
