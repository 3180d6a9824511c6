"""Walks recordings and measures every picture once, whatever the metric asks for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import RecordingError
from rig.core.types import Frame, Intrinsics, Lost, Pair, PairRecord, Truth
from rig.models.metrics import Drive, TargetMetric
from rig.models.posing import pose_error_deg, true_motion
from rig.vision.bayer import to_grey, to_rgb224
from rig.vision.metrics.features import features
from rig.vision.orb import OrbFeatures, OrbFrontEnd

MATCHES = OrbFrontEnd(features_max=2_000)
"""M_grid: ORB 2000 at 512 x 384, mutual matches, fundamental matrix, inliers within 3 px."""

FEATURES = OrbFrontEnd(features_max=10_000)
"""M_feat: counts with a cap that no picture of 512 x 384 reaches."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """n > 1 poses without a loss between them, each with K pictures.

    `images` is uint8 n x K x 3 x 224 x 224, red, green, blue; `trigger` and `pose_index` n long.
    """

    images: NDArray[np.uint8]
    trigger: NDArray[np.int64]
    pose_index: NDArray[np.int64]
    drive: Drive


def stretches(
    records: Iterable[PairRecord], metric: TargetMetric, lenses: Pair[Intrinsics]
) -> Iterator[Stretch]:
    """Yield the measured stretches of a recording; a lone pose between losses is left out.

    The pictures of a pose are those of both cameras, or all that were taken while they stood still
    at one place; a pose that lost one of them ends a stretch.
    """
    poses: list[_Pose] = []
    for pose_index, taken in groupby(records, key=lambda record: record.pose_index):
        pose = _measure(pose_index, list(taken), metric, lenses, poses[-1] if poses else None)
        if poses and (pose is None or not pose.follows(poses[-1])):
            yield from _stretch(poses)
            poses = []
        if pose is not None:
            poses.append(pose)
    yield from _stretch(poses)


@dataclass(frozen=True, slots=True, eq=False)
class _Pose:
    """One pose, measured; `inliers` and `errors` are of each picture before against each here."""

    trigger: int
    last_trigger: int
    pose_index: int
    images: NDArray[np.uint8]
    used: list[tuple[float, float]]
    features: list[int]
    uniformity: list[float]
    orb: list[OrbFeatures]
    truth: Truth | None
    inliers: list[list[int]]
    errors: list[list[float]]

    def follows(self, before: _Pose) -> bool:
        """Return whether nothing was lost between and there are as many pictures."""
        alike = len(self.used) == len(before.used)
        return alike and self.trigger == before.last_trigger + 1


def _measure(
    pose_index: int,
    records: Sequence[PairRecord],
    metric: TargetMetric,
    lenses: Pair[Intrinsics],
    before: _Pose | None,
) -> _Pose | None:
    pairs = [_both_frames(record) for record in records]
    frames = [frame for pair in pairs if pair is not None for frame in pair]
    if len(frames) < 2 * len(records):
        return None
    greys = [to_grey(frame.image, frame.pixel_format) for frame in frames]
    matched = metric.needs_inliers or metric.needs_motion
    orb = [MATCHES.features(grey) for grey in greys] if matched else []
    last = before.orb if before else []
    truth = records[0].truth
    errors: list[list[float]] = []
    if metric.needs_motion and before is not None:
        motion = true_motion(_known(before.truth), _known(truth))
        errors = [[pose_error_deg(a, b, lenses.primary, motion) for b in orb] for a in last]
    none = [0] * len(frames)
    return _Pose(
        trigger=records[0].trigger,
        last_trigger=records[-1].trigger,
        pose_index=pose_index,
        images=np.stack([_network_picture(frame) for frame in frames]),
        used=[(frame.used.exposure_us, frame.used.gain_db) for frame in frames],
        features=[FEATURES.count(grey) for grey in greys] if metric.needs_features else none,
        uniformity=[features(MATCHES.analysed(grey)).uniformity for grey in greys]
        if metric.needs_uniformity
        else [0.0] * len(frames),
        orb=orb,
        truth=truth,
        inliers=[[MATCHES.match(a, b).inliers for b in orb] for a in last]
        if metric.needs_inliers
        else [],
        errors=errors,
    )


def _known(truth: Truth | None) -> Truth:
    if truth is None:
        raise RecordingError(
            "the recording knows no true poses, which --metric pose needs: simulated drives do"
        )
    return truth


def _stretch(poses: list[_Pose]) -> Iterator[Stretch]:
    if len(poses) < 2:
        return
    none = [[0] * len(poses[0].used)] * len(poses[0].used)
    yield Stretch(
        images=np.stack([pose.images for pose in poses]),
        trigger=np.array([pose.trigger for pose in poses], np.int64),
        pose_index=np.array([pose.pose_index for pose in poses], np.int64),
        drive=Drive(
            used=np.array([pose.used for pose in poses], np.float64),
            features=np.array([pose.features for pose in poses], np.int64),
            uniformity=np.array([pose.uniformity for pose in poses], np.float64),
            inliers=np.array([pose.inliers or none for pose in poses[1:]], np.int64),
            pose_errors_deg=np.array([pose.errors or none for pose in poses[1:]], np.float64),
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
