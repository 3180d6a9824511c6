"""The simulated pair as the loop sees it: pace, scene time, noise and losses."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from plane_scene import PlaneScene

from rig.config import load_camera_model
from rig.core.errors import GrabTimeout, UsageError
from rig.core.types import Frame, Lost, Pair, Settings
from rig.drivers.registry import open_source
from rig.drivers.simulated.camera import SimulatedCamera
from rig.drivers.simulated.source import Drive, SimulatedSource, simulate
from rig.pair import CameraPair, PairShot

DRIVE = Drive(load_camera_model("blackfly-s-u3-31s4"), noise_seed=0)


def open_plane(**changes: object) -> SimulatedSource:
    return simulate(PlaneScene(20.0), replace(DRIVE, **changes), "sim:plane")


def still_pair(prnu: float) -> Pair[NDArray[np.float64]]:
    """Return what two cameras at the same place see, when no pixel differs but by `prnu`."""
    pixel = msgspec.structs.replace(DRIVE.model.pixel, prnu=prnu, dsnu_e=0.0)
    drive = replace(DRIVE, model=msgspec.structs.replace(DRIVE.model, pixel=pixel))
    source = simulate(PlaneScene(0.0, baseline_px=0.0), drive, "sim:plane")
    pair = CameraPair(source)
    pair.apply(Pair(Settings(10_000.0, 0.0), Settings(10_000.0, 0.0)))
    return Pair(*(frame.image.astype(float) for frame in frames(pair.shoot())))


def frames(shot: PairShot) -> Pair[Frame]:
    primary, secondary = shot.frames
    assert isinstance(primary, Frame) and isinstance(secondary, Frame)
    return Pair(primary, secondary)


def test_a_pair_is_complete_and_paced_at_its_rate() -> None:
    pair = CameraPair(open_plane(rate_hz=8.0))
    shots = [pair.shoot() for _ in range(4)]
    assert all(shot.cause == "" and shot.offset_ns == 8_000 for shot in shots)
    starts_ns = [frames(shot).primary.device_time_ns for shot in shots]
    assert np.diff(starts_ns).tolist() == [125_000_000] * 3


def test_exposures_too_long_for_the_rate_slow_the_pair_down() -> None:
    pair = CameraPair(open_plane())
    pair.apply(Pair(Settings(200_000.0, 0.0), Settings(100.0, 0.0)))
    starts_ns = [frames(pair.shoot()).primary.device_time_ns for _ in range(3)]
    assert min(np.diff(starts_ns)) > 200_000_000


@pytest.mark.parametrize("rate_hz", [10.0, None])
def test_decisions_cost_time_only_when_told(rate_hz: float | None) -> None:
    prompt, slow = (
        CameraPair(open_plane(rate_hz=rate_hz, decision_ms=cost_ms)) for cost_ms in (0.0, 150.0)
    )
    spans_ms = []
    for pair in (prompt, slow):
        starts_ns = [frames(pair.shoot()).primary.device_time_ns for _ in range(3)]
        spans_ms.append((starts_ns[2] - starts_ns[0]) / 2e6)
    assert spans_ms[0] <= 100.0
    assert spans_ms[1] >= 150.0


def test_pace_and_thinking_time_change_no_picture() -> None:
    """`max` sees the scene at tenths of a second, like 10 Hz, however long decisions take."""
    pairs = [
        CameraPair(open_plane(rate_hz=rate_hz, decision_ms=cost_ms))
        for rate_hz, cost_ms in ((10.0, 0.0), (None, 0.0), (10.0, 250.0))
    ]
    for _ in range(3):
        first, *others = [frames(pair.shoot()) for pair in pairs]
        for other in others:
            assert np.array_equal(first.primary.image, other.primary.image)
            assert np.array_equal(first.secondary.image, other.secondary.image)


def test_the_scene_moves_by_the_rate() -> None:
    source = open_plane(rate_hz=4.0)
    assert source.drive_triggers == 12
    assert source.truth(6).position_m[0] == pytest.approx(20.0 * 6 / 4.0)


def test_an_edge_that_the_secondary_misses_is_a_loss_with_its_cause() -> None:
    source = open_plane(rate_hz=None)
    pair = CameraPair(source)
    frames(pair.shoot())
    secondary = source.cameras.secondary
    assert isinstance(secondary, SimulatedCamera)
    secondary.apply(Settings(200_000.0, 0.0))
    source.cameras.primary.trigger()
    source.cameras.primary.grab(1.0)
    pair.triggers += 1
    shot = pair.shoot()
    assert isinstance(shot.frames.primary, Frame)
    assert shot.frames.secondary == Lost(2, "secondary: trigger ignored during exposure")
    assert secondary.ignored_triggers == 1
    assert frames(pair.shoot()).secondary.sequence == 3


def test_the_primary_takes_no_trigger_during_its_readout() -> None:
    source = open_plane()
    source.cameras.primary.trigger()
    source.clock.sleep_s(0.010)
    source.cameras.primary.trigger()
    source.cameras.primary.grab(1.0)
    with pytest.raises(GrabTimeout) as caught:
        source.cameras.primary.grab(1.0)
    assert caught.value.cause == "trigger ignored during readout"


def test_the_secondary_takes_a_trigger_during_its_readout() -> None:
    source = open_plane()
    source.cameras.secondary.apply(Settings(10_000.0, 0.0))
    for _ in range(2):
        source.cameras.primary.trigger()
        source.clock.sleep_s(0.020)
    assert [source.cameras.secondary.grab(1.0).sequence for _ in range(2)] == [0, 1]


def test_the_cameras_have_their_own_noise() -> None:
    primary, secondary = still_pair(prnu=0.0)
    assert primary.mean() == pytest.approx(secondary.mean(), abs=0.1)
    assert not np.array_equal(primary, secondary)


def test_the_cameras_have_their_own_fixed_pattern() -> None:
    plain, patterned = still_pair(prnu=0.0), still_pair(prnu=0.3)
    primary, secondary = (
        with_it - without for with_it, without in zip(patterned, plain, strict=True)
    )
    assert primary.std() > 3
    assert abs(np.corrcoef(primary.ravel(), secondary.ravel())[0, 1]) < 0.1


def test_depth_is_in_the_truth_where_it_was_asked_for() -> None:
    plain, deep = open_plane(), open_plane(depth=True)
    depth_m = deep.truth(3).depth_m
    assert plain.truth(3).depth_m is None
    assert depth_m is not None and depth_m.dtype == np.float32
    assert np.array_equal(depth_m, deep.scene.view("primary", 0.3).depth_m)


def test_the_sky_is_infinitely_far() -> None:
    source = open_source("sim:tunnel?size=64x48&depth=on", seed=0)
    assert "&depth=on&" in f"&{source.address.partition('?')[2]}&"
    truth = source.truth(100)
    assert truth is not None and truth.depth_m is not None
    assert np.isinf(truth.depth_m[0]).any()
    assert 1.0 < truth.depth_m[-1].min() < 20.0
    with pytest.raises(UsageError, match="depth must be on or off, got 'yes'"):
        open_source("sim:tunnel?depth=yes", seed=0)
