"""The moments worth looking at: each controller's worst and middling pictures, matches drawn."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.core.types import PairRecord
from rig.evaluation.front_ends import FRONT_ENDS
from rig.evaluation.inliers import Matches, arrived, grey_of
from rig.evaluation.report.wording import labels
from rig.evaluation.statistics import counted
from rig.evaluation.summary import RACE_SIDES, RaceSide, Summary, at
from rig.vision.bayer import to_bgr
from rig.vision.orb import ANALYSIS_SIZE_PX

PICTURE_WIDTH_PX = 560
WEBP_QUALITY = 78
MOST_LINES = 600


@dataclass(frozen=True, slots=True)
class Drawn:
    """The inliers of one front end as SVG path data.

    `flow_path` leads from where each inlier was in the picture before to where it is now,
    `point_path` marks the latter; both in a viewBox of `width_px` x `height_px`, the size that
    the front end looked at, stretched over the picture.
    """

    front_end: str
    width_px: int
    height_px: int
    flow_path: str
    point_path: str
    inliers: int


@dataclass(frozen=True, slots=True)
class Picture:
    """One side's picture at a moment, with the inliers of each front end."""

    side: RaceSide
    data_uri: str
    drawn: tuple[Drawn, ...]
    exposure_us: float
    gain_db: float


@dataclass(frozen=True, slots=True)
class Moment:
    """Both pictures of one trigger, and why it is shown."""

    trigger: int
    titles: tuple[str, ...]
    left: Picture
    right: Picture


def moments(summary: Summary, records: Iterable[PairRecord]) -> list[Moment]:
    """Return the worst and the median moment of either side, in the order of the drive.

    Reads the records once more and keeps no picture but the chosen ones. A moment that is two at
    once (both sides at their worst) comes once with both titles.
    """
    titles = chosen(summary)
    return [
        Moment(
            trigger=record.trigger,
            titles=tuple(titles[record.trigger]),
            left=_picture(summary, "left", before, record),
            right=_picture(summary, "right", before, record),
        )
        for before, record in _neighbours(records)
        if record.trigger in titles
    ]


def chosen(summary: Summary) -> Mapping[int, list[str]]:
    """Return the triggers to show and their titles: worst and median ORB inliers of each side."""
    titles: dict[int, list[str]] = {}
    trigger = summary.series.trigger
    names = labels(summary.left.controller, summary.right.controller)
    for side, name in zip(RACE_SIDES, names, strict=True):
        counts = summary.camera(side).inliers["orb"]
        kept = counted(trigger, counts)
        if kept.size == 0:
            continue
        where = counted(trigger, np.where(np.isnan(counts), np.nan, trigger)).astype(int)
        worst = where[np.argmin(kept)]
        middle = where[np.argmin(np.abs(kept - np.median(kept)))]
        titles.setdefault(int(worst), []).append(f"{name} at its worst")
        titles.setdefault(int(middle), []).append(f"{name} at its median")
    return titles


def _neighbours(records: Iterable[PairRecord]) -> Iterator[tuple[PairRecord, PairRecord]]:
    before: PairRecord | None = None
    for record in records:
        if before is not None:
            yield before, record
        before = record


def _picture(summary: Summary, side: RaceSide, before: PairRecord, record: PairRecord) -> Picture:
    wired = summary.wired(side)
    earlier, frame = arrived(at(before.shot, wired)), arrived(at(record.shot, wired))
    greys = grey_of(earlier), grey_of(frame)
    return Picture(
        side=side,
        data_uri=_data_uri(to_bgr(frame.image, frame.pixel_format)),
        drawn=tuple(_drawn(name, *greys) for name in summary.camera(side).inliers),
        exposure_us=frame.used.exposure_us,
        gain_db=frame.used.gain_db,
    )


def _drawn(name: str, before: NDArray[np.uint8], now: NDArray[np.uint8]) -> Drawn:
    front_end = FRONT_ENDS[name].front_end(None)
    matches = front_end.match(front_end.features(before), front_end.features(now))
    height_px, width_px = now.shape
    if name == "orb":
        width_px, height_px = ANALYSIS_SIZE_PX
    flow, points = _paths(matches)
    inliers = int(np.count_nonzero(matches.inlier_mask))
    return Drawn(name, width_px, height_px, flow, points, inliers)


def _paths(matches: Matches) -> tuple[str, str]:
    """Return the flow lines and the end points of at most MOST_LINES inliers, evenly chosen."""
    inliers = np.flatnonzero(matches.inlier_mask)
    shown = inliers[:: -(-len(inliers) // MOST_LINES)] if len(inliers) else inliers
    a, b = matches.points_a_px[shown], matches.points_b_px[shown]
    flow = "".join(
        f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}" for (x0, y0), (x1, y1) in zip(a, b, strict=True)
    )
    return flow, "".join(f"M{x:.1f} {y:.1f}h0" for x, y in b)


def _data_uri(bgr: NDArray[np.uint8]) -> str:
    height, width = bgr.shape[:2]
    if width > PICTURE_WIDTH_PX:
        size = (PICTURE_WIDTH_PX, round(height * PICTURE_WIDTH_PX / width))
        bgr = np.asarray(cv2.resize(bgr, size, interpolation=cv2.INTER_AREA), np.uint8)
    _, webp = cv2.imencode(".webp", bgr, [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY])
    return "data:image/webp;base64," + base64.b64encode(webp.tobytes()).decode("ascii")
