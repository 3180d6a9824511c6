"""Visual odometry over a drive: which pictures told a motion, and how true the way was."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics
from rig.vision.viso2.front_end import Viso2Features, Viso2FrontEnd
from rig.vision.viso2.motion import Failure, Mount

Array = NDArray[np.float64]

REFERENCE_AGE_MAX = 10
"""A reference that this many pictures in a row could not be told from is given up."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """What one picture told against the reference before it.

    `matches` and `inliers` are bucketed. `transform`, 4 x 4, turns coordinates of the reference
    camera into this one's, metres; None when `failure` says why there is none.
    """

    trigger: int
    reference: int
    matches: int
    inliers: int
    failure: Failure
    transform: Array | None

    @property
    def inlier_pct(self) -> float:
        """Return inliers in per cent of matches; 0 for a picture that told no motion."""
        return 100.0 * self.inliers / self.matches if self.transform is not None else 0.0


class OdometryCounter:
    """Follows one camera: unbucketed inliers from picture to picture, and its motion.

    Two things are looked at. `count` matches each picture with the one before it. The motion is
    told against the last picture that told one: where it fails, the older picture stays the
    reference, across lost frames too, until it is `REFERENCE_AGE_MAX` pictures out of date.
    """

    def __init__(self, front_end: Viso2FrontEnd, intrinsics: Intrinsics, mount: Mount) -> None:
        self._front_end = front_end
        self._intrinsics = intrinsics
        self._mount = mount
        self._last: tuple[int, Viso2Features] | None = None
        self._reference: tuple[int, Viso2Features] | None = None
        self._failures = 0
        self.steps: list[Step] = []

    def count(self, trigger: int, grey: NDArray[np.uint8]) -> float:
        """Return the unbucketed inliers between the picture of `trigger - 1` and this H x W one.

        NaN when the last picture given was not that of `trigger - 1`. Adds to `steps`.
        """
        front_end, last, reference = self._front_end, self._last, self._reference
        features = front_end.features(grey)
        self._last = (trigger, features)
        points = None
        inliers = np.nan
        if last is not None and last[0] == trigger - 1:
            points = front_end.matched(last[1], features)
            inliers = float(front_end.judged(points).inliers)
        if reference is None:
            self._reference = self._last
            return inliers
        if points is None or reference is not last:
            points = front_end.matched(reference[1], features)
        bucketed = front_end.bucket(points)
        motion = front_end.motion(bucketed, self._intrinsics, self._mount)
        self.steps.append(
            Step(
                trigger=trigger,
                reference=reference[0],
                matches=len(bucketed),
                inliers=motion.inliers,
                failure=motion.failure,
                transform=motion.transform,
            )
        )
        self._keep_or_replace(motion.transform is not None)
        return inliers

    def _keep_or_replace(self, told: bool) -> None:
        self._failures = 0 if told else self._failures + 1
        if told or self._failures >= REFERENCE_AGE_MAX:
            self._reference, self._failures = self._last, 0


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses over a drive, N x 4 x 4 from camera to world, metres, in the order of `triggers`."""

    triggers: NDArray[np.int64]
    poses: Array

    def __len__(self) -> int:
        return len(self.triggers)

    @property
    def positions(self) -> Array:
        """Return where the camera was, N x 3."""
        return self.poses[:, :3, 3]

    def since(self, trigger: int) -> Trajectory:
        """Return the poses from a trigger on."""
        kept = self.triggers >= trigger
        return Trajectory(self.triggers[kept], self.poses[kept])

    def only(self, triggers: Iterable[int]) -> Trajectory:
        """Return the poses of some triggers."""
        kept = np.isin(self.triggers, list(triggers))
        return Trajectory(self.triggers[kept], self.poses[kept])


def chain(steps: Sequence[Step]) -> Trajectory:
    """Return the way that steps tell: the first reference is the origin.

    A picture that told no motion has no pose. Where a reference was given up, the way goes on
    from the last pose as if the camera had stood still meanwhile.
    """
    if not steps:
        return Trajectory(np.empty(0, np.int64), np.empty((0, 4, 4)))
    known: dict[int, Array] = {steps[0].reference: np.eye(4)}
    last = known[steps[0].reference]
    for step in steps:
        if step.transform is not None:
            last = known.setdefault(step.reference, last) @ np.linalg.inv(step.transform)
            known[step.trigger] = last
    return Trajectory(np.array(list(known), np.int64), np.array(list(known.values())))


@dataclass(frozen=True, slots=True)
class Accuracy:
    """How true a way was.

    `ate_m` is the root mean square distance after the best rotation, shift and scale (absolute
    trajectory error); `rpe_m` and `rpe_deg` are the root mean square errors of translation and
    rotation from one pose to the next (relative pose error), at that scale. `scale` is what the
    way had to be multiplied by, 1 for a true ground plane. `poses` were compared.
    """

    ate_m: float
    rpe_m: float
    rpe_deg: float
    scale: float
    poses: int


def accuracy(estimated: Trajectory, truth: Trajectory) -> Accuracy | None:
    """Return the errors of a way at the triggers that both have; None for fewer than three poses.

    None as well when the estimate, or the truth, never moved.
    """
    shared = np.intersect1d(estimated.triggers, truth.triggers)
    if len(shared) < 3:
        return None
    a, b = estimated.only(shared), truth.only(shared)
    aligned = align(a.positions, b.positions)
    if aligned is None:
        return None
    scale, rotation, shift = aligned
    apart = (scale * a.positions @ rotation.T + shift) - b.positions
    scaled = a.poses.copy()
    scaled[:, :3, 3] *= scale
    errors = np.linalg.inv(_moves(b.poses)) @ _moves(scaled)
    cosine = (np.trace(errors[:, :3, :3], axis1=1, axis2=2) - 1) / 2
    angle_deg = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return Accuracy(
        ate_m=_rms(np.linalg.norm(apart, axis=1)),
        rpe_m=_rms(np.linalg.norm(errors[:, :3, 3], axis=1)),
        rpe_deg=_rms(angle_deg),
        scale=scale,
        poses=len(shared),
    )


def align(points: Array, truth: Array) -> tuple[float, Array, Array] | None:
    """Return (scale, rotation, shift) that bring N x 3 points nearest to others (Umeyama, 1991).

    None when either set is a single place.
    """
    centre, centre_truth = points.mean(axis=0), truth.mean(axis=0)
    around, around_truth = points - centre, truth - centre_truth
    spread, spread_truth = (around**2).sum(), (around_truth**2).sum()
    if spread < 1e-12 or spread_truth < 1e-12:
        return None
    u, s, vt = np.linalg.svd(around_truth.T @ around)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * signs) @ vt
    scale = float((s * signs).sum() / spread)
    return scale, rotation, centre_truth - scale * rotation @ centre


def _moves(poses: Array) -> Array:
    return np.asarray(np.linalg.inv(poses[:-1]) @ poses[1:])


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """What visual odometry made of one camera's drive; `truth` is empty where nobody knows it."""

    steps: tuple[Step, ...]
    truth: Trajectory
    estimated: Trajectory = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "estimated", chain(self.steps))

    def since(self, trigger: int) -> tuple[Step, ...]:
        """Return the steps from a trigger on."""
        return tuple(step for step in self.steps if step.trigger >= trigger)

    def way(self, since: int) -> Trajectory:
        """Return the told way from the picture before trigger `since` on."""
        return self.estimated.since(since - 1)

    def as_json(self, since: int) -> dict[str, object]:
        """Return the numbers under `odometry`, of the steps from trigger `since` on."""
        steps = self.since(since)
        told = accuracy(self.way(since), self.truth)
        return {
            "frames": len(steps),
            "frames_lost": sum(1 for step in steps if step.failure),
            "failures": failures(steps),
            "ate_m": told.ate_m if told else None,
            "rpe_m": told.rpe_m if told else None,
            "rpe_deg": told.rpe_deg if told else None,
            "scale": told.scale if told else None,
        }


def failures(steps: Iterable[Step]) -> Mapping[str, int]:
    """Return how many pictures each reason kept from telling a motion, the most frequent first."""
    return dict(Counter(step.failure for step in steps if step.failure).most_common())


def processed_pct(steps: Sequence[Step]) -> float | None:
    """Return the share of pictures that told a motion (thesis table 5.5); None for none at all."""
    return 100.0 * sum(1 for s in steps if not s.failure) / len(steps) if steps else None


def mean_inlier_pct(steps: Sequence[Step]) -> float | None:
    """Return the mean of bucketed inliers in per cent of matches (thesis table 5.5).

    A picture that told no motion counts as 0: with the two columns of table 5.5 in one proportion
    throughout, the thesis' numbers fit no other reading.
    """
    return float(np.mean([step.inlier_pct for step in steps])) if steps else None


def pose_matrix(position_m: Sequence[float], orientation_xyzw: Sequence[float]) -> Array:
    """Return the 4 x 4 of a position and a unit quaternion."""
    x, y, z, w = orientation_xyzw
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = position_m
    return pose


def quaternion_xyzw(rotation: Array) -> Array:
    """Return the unit quaternion of a 3 x 3 rotation, w >= 0."""
    r = rotation
    outer = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    _, vectors = np.linalg.eigh(outer, "L")
    quaternion = vectors[:, -1]
    return np.asarray(quaternion if quaternion[3] >= 0 else -quaternion)


def write_tum(path: Path, times_s: Mapping[int, float], trajectory: Trajectory) -> None:
    """Write a way as TUM lines: time, x y z, qx qy qz qw; `times_s` maps triggers to seconds."""
    lines = [
        " ".join(f"{value:.9g}" for value in (*pose[:3, 3], *quaternion_xyzw(pose[:3, :3])))
        for pose in trajectory.poses
    ]
    rows = [
        f"{times_s[int(trigger)]:.9f} {line}\n"
        for trigger, line in zip(trajectory.triggers, lines, strict=True)
    ]
    path.write_text("".join(rows), encoding="ascii")
