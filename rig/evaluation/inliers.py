"""Inlier matches between one picture and the next: what a picture is worth to visual odometry."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rig.core.types import Frame, Lost, Pair, PairRecord
from rig.vision.bayer import to_grey
from rig.vision.orb import OrbFrontEnd


class Matches(Protocol):
    """What a front end found in two pictures; rows of points and mask belong together."""

    @property
    def points_a_px(self) -> NDArray[np.number[Any]]:
        """Return where the matches are in the first picture, N x 2 (x, y) in analysed pixels."""
        ...

    @property
    def points_b_px(self) -> NDArray[np.number[Any]]:
        """Return where the matches are in the second picture, N x 2 (x, y) in analysed pixels."""
        ...

    @property
    def inlier_mask(self) -> NDArray[np.bool_]:
        """Return which of the N matches agree with one motion of the camera."""
        ...


class FrontEnd(Protocol):
    """Finds features in a picture and matches those of two; `features` are its own secret."""

    def features(self, grey: NDArray[np.uint8]) -> Any:
        """Return the features of an H x W picture."""
        ...

    def match(self, a: Any, b: Any) -> Matches:
        """Return the matches between the features of two pictures."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class InlierSeries:
    """Inlier counts over a run: `counts[i]` belongs to trigger `triggers[i]`, NaN is no count."""

    triggers: NDArray[np.int64]
    counts: NDArray[np.float64]


class InlierCounter:
    """Follows one camera and keeps only the features of its last picture."""

    def __init__(self, front_end: FrontEnd) -> None:
        self._front_end = front_end
        self._last: tuple[int, Any] | None = None

    def count(self, trigger: int, grey: NDArray[np.uint8]) -> float:
        """Return the inliers between the picture of `trigger - 1` and this H x W one.

        NaN when the last picture given was not that of `trigger - 1`: a gap is never bridged,
        for matching over two intervals is another task than matching over one.
        """
        last = self._last
        features = self._front_end.features(grey)
        self._last = (trigger, features)
        if last is None or last[0] != trigger - 1:
            return np.nan
        return float(np.count_nonzero(self._front_end.match(last[1], features).inlier_mask))


def arrived(shot: Frame | Lost) -> Frame:
    """Return the frame of a complete pair; raises ValueError when it was lost."""
    if isinstance(shot, Lost):
        raise ValueError(f"the frame of trigger {shot.sequence} is lost: {shot.cause}")
    return shot


def grey_of(frame: Frame) -> NDArray[np.uint8]:
    """Return the grey picture of a frame, uint8 H x W."""
    return to_grey(frame.image, frame.pixel_format)


def orb_inliers(records: Iterable[PairRecord]) -> Pair[InlierSeries]:
    """Return the ORB inliers of both cameras (thesis 5.2; recipe in rig.vision.orb).

    The count of trigger k is between the pictures of k - 1 and k. It exists only where both of
    these pairs are complete, for either camera alike, so both are judged on the same moments; an
    incomplete pair takes two counts away. One entry a record; memory does not grow with pictures.
    """
    counters = Pair(InlierCounter(OrbFrontEnd()), InlierCounter(OrbFrontEnd()))
    triggers: list[int] = []
    counts: list[list[float]] = []
    for record in records:
        triggers.append(record.trigger)
        counts.append(
            [
                counter.count(record.trigger, grey_of(arrived(shot))) if record.complete else np.nan
                for counter, shot in zip(counters, record.shot, strict=True)
            ]
        )
    columns = np.array(counts, np.float64).reshape(-1, 2)
    index = np.array(triggers, np.int64)
    return Pair(InlierSeries(index, columns[:, 0]), InlierSeries(index, columns[:, 1]))
