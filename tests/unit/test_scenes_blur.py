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

PLACES = {"tunnel": (12, 28, 50, 75, 105), "route": (12, 80, 150, 300, 470)}
LENS = Intrinsics(64, 48, 56.0, 56.0, 31.5, 23.5)


def at(x_m: float, z_m: float = 0.0) -> Pose:
    return Pose(np.eye(3), np.array([x_m, 0.0, z_m]))


def blurred(radiance: np.ndarray, depth_m: float, *poses: Pose) -> np.ndarray:
    depth = np.full_like(radiance, depth_m)
    return flow_blur(radiance, radiance, depth, LENS, poses)


def line(columns: np.ndarray) -> np.ndarray:
    """Return a bright line 6 px wide with soft sides, at any place between pixels."""
    return 1.0 + 99.0 * np.exp(-(((columns - 32.0) / 3.0) ** 2))


def test_a_bright_line_smears_evenly_over_the_way_it_moves() -> None:
    columns = np.arange(64)
    radiance = np.tile(line(columns), (48, 1)).astype(np.float32)
    for steps_px in (0.4, 1.0, 3.3, 8.0, 20.0):
        moved_m = steps_px * 2.0 / LENS.fx_px
        smear = blurred(radiance, 2.0, at(0.0), at(moved_m))[24]
        moments = [line(columns + k) for k in np.linspace(0, steps_px, 2001)]
        assert smear[:40] == pytest.approx(np.mean(moments, axis=0)[:40], abs=0.2)


def test_what_comes_nearer_moves_faster_at_the_end() -> None:
    """A road recedes; a point of it near the border passes its last pixels quickest."""
    columns = np.arange(64)
    radiance = np.tile(line(columns - 28.0), (48, 1)).astype(np.float32)
    ways_m = np.linspace(0.0, 1.0, 9)
    smear = blurred(radiance, 2.0, *(at(0.0, z_m) for z_m in ways_m))[24]
    moments = [
        line(LENS.cx_px + (columns - LENS.cx_px) * 2.0 / (2.0 + z_m) - 28.0)
        for z_m in np.linspace(0.0, 1.0, 2001)
    ]
    assert smear == pytest.approx(np.mean(moments, axis=0), abs=0.4)


def test_no_motion_returns_the_view_itself() -> None:
    radiance = np.random.default_rng(0).uniform(1.0, 9.0, (48, 64)).astype(np.float32)
    assert blurred(radiance, 2.0, at(0.0), at(0.0)) == pytest.approx(radiance, rel=1e-5)


def test_a_camera_that_shakes_and_comes_back_blurs_all_the_same() -> None:
    radiance = np.tile(line(np.arange(64)), (48, 1)).astype(np.float32)
    aside = at(4 * 2.0 / LENS.fx_px)
    there = blurred(radiance, 2.0, at(0.0), aside)
    assert abs(there - radiance).max() > 10.0
    assert blurred(radiance, 2.0, at(0.0), aside, at(0.0)) == pytest.approx(there, rel=1e-3)


@pytest.mark.parametrize("moved_px", [0.5, 1.0, 2.5])
def test_fine_detail_loses_only_what_motion_takes(moved_px: float) -> None:
    """The sharpest pattern a rendered view shows well has a period of 4 px."""

    def wave(columns: np.ndarray) -> np.ndarray:
        return 10.0 + 5.0 * np.sin(np.pi / 2 * columns + 0.3)

    columns = np.arange(64)
    radiance = np.tile(wave(columns), (48, 1)).astype(np.float32)
    moments = [wave(columns + k) for k in np.linspace(0, moved_px, 1001)]
    smear = blurred(radiance, 2.0, at(0.0), at(moved_px * 2.0 / LENS.fx_px))[24]
    assert smear[8:-8] == pytest.approx(np.mean(moments, axis=0)[8:-8], abs=0.2)


def test_nothing_gets_much_darker_than_the_darkest_around_a_lamp() -> None:
    radiance = np.ones((48, 64), np.float32)
    radiance[20:23, 30:33] = 3e5
    assert blurred(radiance, 2.0, at(0.0), at(0.013, 0.02)).min() >= 0.56


def test_a_flow_beyond_the_picture_stays_a_mean_of_it() -> None:
    radiance = np.random.default_rng(0).uniform(1.0, 9.0, (48, 64)).astype(np.float32)
    smear = blurred(radiance, 0.5, at(0.0), at(40.0))
    assert np.isfinite(smear).all()
    assert smear.min() > 0.2 and smear.max() < 40.0


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("world", "seed"), [("tunnel", 0), ("tunnel", 5), ("tunnel", 6), ("route", 31)]
)
@pytest.mark.parametrize("exposure_us", [5_000.0, 15_000.0, 30_000.0])
def test_flow_blur_agrees_with_exact_sub_exposures_in_five_places(
    world: str, seed: int, exposure_us: float
) -> None:
    scene = open_world(world, seed=seed, split="test", width_px=640, height_px=480, speed_mps=13.9)
    assert isinstance(scene, RenderedScene)
    for place in PLACES[world]:
        found = blur_agreement(scene, range(place - 2, place + 1), exposure_us)
        assert found.log_error < 0.03, place
        assert found.inlier_error < 0.1, place
