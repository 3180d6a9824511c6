"""Blur by depth flow against the slow oracle, in light and in inliers."""

from __future__ import annotations

import numpy as np
import pytest

from rig.core.types import Intrinsics
from rig.drivers.scenes.blur import flow_blur
from rig.drivers.scenes.trajectories import Pose
from rig.drivers.scenes.world import RenderedScene
from rig.drivers.scenes.worlds import open_world
from rig.experiments.blur import blur_agreement

PLACES = (12, 28, 50, 75, 105)
LENS = Intrinsics(64, 48, 56.0, 56.0, 31.5, 23.5)


def at(x_m: float, z_m: float = 0.0) -> Pose:
    return Pose(np.eye(3), np.array([x_m, 0.0, z_m]))


def blurred(radiance: np.ndarray, depth_m: float, start: Pose, end: Pose) -> np.ndarray:
    depth = np.full_like(radiance, depth_m)
    return flow_blur(radiance, radiance, depth, LENS, start, end)


def test_a_bright_line_smears_evenly_over_the_way_it_moves() -> None:
    radiance = np.ones((48, 64), np.float32)
    radiance[:, 30:34] = 100.0
    steps_px = 8
    moved_m = steps_px * 2.0 / LENS.fx_px
    smear = blurred(radiance, 2.0, at(0.0), at(moved_m))[24]
    moments = [np.roll(radiance[24], -round(k)) for k in np.linspace(0, steps_px, 2001)]
    assert smear == pytest.approx(np.mean(moments, axis=0), rel=0.02, abs=0.5)


def test_what_comes_nearer_moves_faster_at_the_end() -> None:
    """A road recedes; a point of it near the border passes its last pixels quickest."""
    radiance = np.ones((48, 64), np.float32)
    radiance[:, 60:] = 50.0
    slow = blurred(radiance, 2.0, at(0.0), at(0.0, 1.0))
    columns = slow[24, 50:60]
    assert (np.diff(columns) >= 0).all()
    assert columns[-1] < 50.0


def test_no_motion_returns_the_view_itself() -> None:
    radiance = np.random.default_rng(0).uniform(1.0, 9.0, (48, 64)).astype(np.float32)
    assert blurred(radiance, 2.0, at(0.0), at(0.0)) == pytest.approx(radiance, rel=1e-5)


def test_a_flow_beyond_the_picture_stays_a_mean_of_it() -> None:
    radiance = np.random.default_rng(0).uniform(1.0, 9.0, (48, 64)).astype(np.float32)
    smear = blurred(radiance, 0.5, at(0.0), at(40.0))
    assert np.isfinite(smear).all()
    assert smear.min() > 0.2 and smear.max() < 40.0


@pytest.mark.heavy
@pytest.mark.parametrize("seed", [0, 5, 6])
@pytest.mark.parametrize("exposure_us", [5_000.0, 15_000.0, 30_000.0])
def test_flow_blur_agrees_with_exact_sub_exposures_in_five_places(
    seed: int, exposure_us: float
) -> None:
    scene = open_world(
        "tunnel", seed=seed, split="test", width_px=640, height_px=480, speed_mps=13.9
    )
    assert isinstance(scene, RenderedScene)
    for place in PLACES:
        found = blur_agreement(scene, range(place - 2, place + 1), exposure_us)
        assert found.log_error < 0.03, place
        assert found.inlier_error < 0.1, place
