"""Walks recordings and measures every picture once, whatever the metric asks for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.types import Frame, Lost, Pair, PairRecord
from rig.models.metrics import Drive, TargetMetric
from rig.vision.bayer import to_grey, to_rgb224
from rig.vision.orb import OrbFeatures, OrbFrontEnd

MATCHES = OrbFrontEnd(features_max=2_000)
"""M_grid: ORB 2000 at 512 x 384, mutual matches, fundamental matrix, inliers within 3 px."""

FEATURES = OrbFrontEnd(features_max=10_000)
"""M_feat: counts with a cap that no picture of 512 x 384 reaches."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """n > 1 complete pairs without a loss between them.

    `images` is uint8 n x 2 x 3 x 224 x 224, red, green, blue; `trigger` and `pose_index` n long.
    """

    images: NDArray[np.uint8]
    trigger: NDArray[np.int64]
    pose_index: NDArray[np.int64]
    drive: Drive


def stretches(records: Iterable[PairRecord], metric: TargetMetric) -> Iterator[Stretch]:
    """Yield the measured stretches of a recording; a lone pair between losses is left out."""
    pairs: list[_Pair] = []
    for record in records:
        frames = _both_frames(record)
        follows = bool(pairs) and record.trigger == pairs[-1].trigger + 1
        if pairs and (frames is None or not follows):
            yield from _stretch(pairs)
            pairs = []
        if frames is not None:
            pairs.append(_measure(record, frames, metric, pairs[-1] if pairs else None))
    yield from _stretch(pairs)


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """One pair, measured; `inliers` [a][b]: camera a at the pair before against camera b here."""

    trigger: int
    pose_index: int
    images: NDArray[np.uint8]
    used: list[tuple[float, float]]
    features: list[int]
    orb: list[OrbFeatures]
    inliers: list[list[int]]


def _measure(
    record: PairRecord, frames: Pair[Frame], metric: TargetMetric, before: _Pair | None
) -> _Pair:
    greys = [to_grey(frame.image, frame.pixel_format) for frame in frames]
    orb = [MATCHES.features(grey) for grey in greys] if metric.needs_inliers else []
    return _Pair(
        trigger=record.trigger,
        pose_index=record.pose_index,
        images=np.stack([_network_picture(frame) for frame in frames]),
        used=[(frame.used.exposure_us, frame.used.gain_db) for frame in frames],
        features=[FEATURES.count(grey) for grey in greys] if metric.needs_features else [0, 0],
        orb=orb,
        inliers=[[MATCHES.match(a, b).inliers for b in orb] for a in before.orb] if before else [],
    )


def _stretch(pairs: list[_Pair]) -> Iterator[Stretch]:
    if len(pairs) < 2:
        return
    inliers = [pair.inliers or [[0, 0], [0, 0]] for pair in pairs[1:]]
    yield Stretch(
        images=np.stack([pair.images for pair in pairs]),
        trigger=np.array([pair.trigger for pair in pairs], np.int64),
        pose_index=np.array([pair.pose_index for pair in pairs], np.int64),
        drive=Drive(
            used=np.array([pair.used for pair in pairs], np.float64),
            features=np.array([pair.features for pair in pairs], np.int64),
            inliers=np.array(inliers, np.int64),
        ),
    )


def _both_frames(record: PairRecord) -> Pair[Frame] | None:
    primary, secondary = record.shot
    if not record.complete or isinstance(primary, Lost) or isinstance(secondary, Lost):
        return None
    return Pair(primary, secondary)


def _network_picture(frame: Frame) -> NDArray[np.uint8]:
    picture = to_rgb224(frame.image, frame.pixel_format)
    return np.asarray(np.rint(picture * np.float32(255)), np.uint8)
