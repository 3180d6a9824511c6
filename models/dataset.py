"""Training samples: what a network sees at a pose, gathered from target files.

A sample takes each of the frames t, t-1 and t-2 from either camera, so a pose gives up to eight;
of a sweep, whose poses have many pictures, 25 are drawn, well and badly exposed ones (thesis
4.2.5). At the start of a drive the oldest frame stands in for those before it. Pictures stay uint8,
as they lie in the file, until a batch is used.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.types import THESIS_LIMITS, Limits
from rig.models.targets import Poses, Targets

FRAMES = 3
DB_PER_STOP = 20 * math.log10(2)

SWEEP_SAMPLES = 25
"""At most so many samples of a pose with more pictures than a pair has."""

SWEEP_STRAY_EV = 3.0
SWEEP_JITTER_EV = 0.7
"""A sample of a sweep is too dark or too bright by up to the first, each of its frames by another
amount of about the second."""


class Batch(NamedTuple):
    """N samples, newest frame first.

    `images` is uint8 N x 9 x 224 x 224; `settings` float32 N x 6 and `targets` float32 N x 2 are
    scaled to the limits (eq. 4.14).
    """

    images: NDArray[np.uint8]
    settings: NDArray[np.float32]
    targets: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """The frames and samples of one target file; frame K * pose + picture."""

    images: NDArray[np.uint8]
    settings: NDArray[np.float32]
    targets: NDArray[np.float32]
    pictures: int


class Samples:
    """The samples of some target files' recordings; `len` counts them.

    `recordings` are the sha256 of those to take.
    """

    def __init__(self, files: Sequence[Targets], recordings: frozenset[str]) -> None:
        self._parts = [_part(targets.poses) for targets in files]
        indexes = [_sample_frames(targets, recordings) for targets in files]
        self._frames = np.concatenate(indexes)
        self._part_of = np.repeat(np.arange(len(files)), [len(index) for index in indexes])

    def __len__(self) -> int:
        return len(self._frames)

    def batch(self, chosen: NDArray[np.intp]) -> Batch:
        """Gather the samples with the given indexes, in their order."""
        images = np.empty((len(chosen), FRAMES, *self._parts[0].images.shape[1:]), np.uint8)
        settings = np.empty((len(chosen), FRAMES, 2), np.float32)
        targets = np.empty((len(chosen), 2), np.float32)
        for row, sample in enumerate(chosen):
            part, frames = self._parts[self._part_of[sample]], self._frames[sample]
            images[row] = part.images[frames]
            settings[row] = part.settings[frames]
            targets[row] = part.targets[frames[0] // part.pictures]
        return Batch(
            images.reshape(len(chosen), -1, *images.shape[3:]),
            settings.reshape(len(chosen), -1),
            targets,
        )

    def batches(self, size: int) -> Iterator[Batch]:
        """Yield all samples in order; the last batch may be smaller."""
        for start in range(0, len(self), size):
            yield self.batch(np.arange(start, min(start + size, len(self))))


def scale_settings(
    exposure_us: NDArray[np.float64], gain_db: NDArray[np.float64], limits: Limits = THESIS_LIMITS
) -> NDArray[np.float32]:
    """Return (exposure, gain) in 0..1 of the limits on a new last axis (eq. 4.14, without 255)."""
    scaled = [
        (values - low) / (high - low)
        for values, (low, high) in ((exposure_us, limits.exposure_us), (gain_db, limits.gain_db))
    ]
    return np.stack(scaled, axis=-1).astype(np.float32)


def _part(poses: Poses) -> _Part:
    return _Part(
        images=poses.images.reshape(-1, *poses.images.shape[2:]),
        settings=scale_settings(poses.used_exposure_us, poses.used_gain_db).reshape(-1, 2),
        targets=scale_settings(poses.target_exposure_us, poses.target_gain_db),
        pictures=poses.images.shape[1],
    )


def _sample_frames(targets: Targets, recordings: frozenset[str]) -> NDArray[np.intp]:
    """Return the samples' frames, samples x 3, newest first; no sample twice."""
    poses = targets.poses
    wanted = [source.sha256 in recordings for source in targets.recordings]
    choose = _pair_choices if poses.images.shape[1] == 2 else _sweep_choices
    samples: list[list[int]] = []
    start = 0
    for pose in range(len(poses)):
        if pose and poses.drive[pose] != poses.drive[pose - 1]:
            start = pose
        if wanted[poses.recording[pose]]:
            seen = [pose - back for back in range(FRAMES) if pose - back >= start]
            samples += _padded(choose(poses, seen))
    return np.array(samples, np.intp).reshape(-1, FRAMES)


def _pair_choices(_poses: Poses, seen: list[int]) -> list[list[int]]:
    """Return every way to take each pose's frame from either camera."""
    return [
        [2 * at + camera for at, camera in zip(seen, cameras, strict=True)]
        for cameras in product((0, 1), repeat=len(seen))
    ]


def _sweep_choices(poses: Poses, seen: list[int]) -> list[list[int]]:
    """Return frames that are from too dark to too bright for the target, evenly, and unalike."""
    rng = np.random.default_rng(seen[0])
    target_ev = _ev(poses.target_exposure_us[seen[0]], poses.target_gain_db[seen[0]])
    used_ev = _ev(poses.used_exposure_us[seen], poses.used_gain_db[seen])
    strays_ev = np.linspace(-SWEEP_STRAY_EV, SWEEP_STRAY_EV, SWEEP_SAMPLES)
    jitter_ev = rng.normal(0, SWEEP_JITTER_EV, (SWEEP_SAMPLES, len(seen)))
    wanted_ev = target_ev + strays_ev[:, None] + jitter_ev
    nearest = np.abs(used_ev[None] - wanted_ev[:, :, None]).argmin(2)
    frames = np.array(seen) * poses.images.shape[1] + nearest
    return [list(chosen) for chosen in dict.fromkeys(map(tuple, frames.tolist()))]


def _padded(choices: list[list[int]]) -> list[list[int]]:
    """Return frames for t, t-1 and t-2; the oldest stands in for those before the drive."""
    return [frames + [frames[-1]] * (FRAMES - len(frames)) for frames in choices]


def _ev(exposure_us: Any, gain_db: Any) -> NDArray[np.float64]:
    return np.asarray(np.log2(exposure_us) + gain_db / DB_PER_STOP)
