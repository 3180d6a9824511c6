"""Small target files in memory: a texture under changing light, seen with random settings."""

from __future__ import annotations

import numpy as np

from rig.models.targets import Poses, RecordingSource, Targets


def make_source(seed: int, cameras: str | None = None) -> RecordingSource:
    return RecordingSource(
        name=f"drive-{seed}",
        sha256=f"{seed:064d}",
        triggers=13,
        command="collect",
        cameras=cameras or f"sim:tunnel?seed={seed}&split=train",
        seed=seed,
        leader="aeag",
        options={"perturb": "cycle"},
    )


def make_poses(count: int, seed: int, recording: int = 0, drive: int = 0) -> Poses:
    """The darker the light, the longer the exposure and the higher the gain to aim for."""
    rng = np.random.default_rng(seed)
    texture = rng.uniform(0.5, 1.0, (3, 224, 224)).astype(np.float32)
    dark = rng.uniform(0.0, 0.9, count)
    exposure_us, gain_db = rng.uniform(75, 30_000, (count, 2)), rng.uniform(0, 30, (count, 2))
    bright = 255 * (1 - dark[:, None]) * (0.3 + 0.7 * exposure_us / 30_000)
    images = bright[:, :, None, None, None] * texture
    at = np.arange(count)
    return Poses(
        images=images.astype(np.uint8),
        used_exposure_us=exposure_us,
        used_gain_db=gain_db,
        target_exposure_us=75 + 29_925 * dark,
        target_gain_db=30 * dark,
        trigger=at,
        pose_index=at,
        recording=np.full(count, recording),
        drive=np.full(count, drive),
    )


def make_targets_file(seed: int, count: int = 12, cameras: str | None = None) -> Targets:
    return Targets("hybrid", 4, 0.5, (make_source(seed, cameras),), make_poses(count, seed))
