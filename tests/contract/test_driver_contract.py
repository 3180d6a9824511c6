"""What every driver promises to the loop; one suite, run over each of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from plane_scene import PlaneScene
from served_pair import needs_aravis, open_served, plane_plan
from usb3.opening import needs_usb, open_in_step

from rig.config import load_camera_model
from rig.core.autoexposure import metered_dn
from rig.core.errors import CameraError, CameraLost, GrabTimeout
from rig.core.protocols import Source
from rig.core.types import Auto, Command, Frame, Limits, Metering, Pair, Settings
from rig.drivers.simulated.source import Drive, simulate

TIMEOUT_S = 2.0


OpenSource = Callable[..., Source]


def open_simulated(*, seed: int = 0, latency_frames: int = 0, moving: bool = True) -> Source:
    drive = Drive(
        load_camera_model("blackfly-s-u3-31s4"), noise_seed=seed, latency_frames=latency_frames
    )
    return simulate(PlaneScene(20.0 if moving else 0.0), drive, "sim:plane")


def open_gige(*, seed: int = 0, latency_frames: int = 0, moving: bool = True) -> Source:
    speed_px_s = 20.0 if moving else 0.0
    plan = plane_plan(seed, speed_px_s, latency_frames=latency_frames)
    return open_served(plan, PlaneScene(speed_px_s))


def open_usb(*, seed: int = 0, latency_frames: int = 0, moving: bool = True) -> Source:
    speed_px_s = 20.0 if moving else 0.0
    plan = plane_plan(seed, speed_px_s, latency_frames=latency_frames)
    return open_in_step(plan, PlaneScene(speed_px_s))


@pytest.fixture(
    params=[
        pytest.param(open_simulated, id="simulated"),
        pytest.param(open_gige, id="gige", marks=needs_aravis),
        pytest.param(open_usb, id="usb", marks=needs_usb),
    ]
)
def open_source(request: pytest.FixtureRequest) -> Iterator[OpenSource]:
    """Open a driver's pair over the plane; everything opened is closed after the test."""
    opened: list[Source] = []

    def opener(**options: object) -> Source:
        opened.append(request.param(**options))
        return opened[-1]

    yield opener
    for source in opened:
        source.close()


def shoot(source: Source, commands: Pair[Command] | None = None) -> Pair[Frame]:
    cameras = source.cameras
    if commands is not None:
        for camera, command in zip(cameras, commands, strict=True):
            camera.apply(command)
    cameras.primary.trigger()
    return Pair(cameras.primary.grab(TIMEOUT_S), cameras.secondary.grab(TIMEOUT_S))


def both(exposure_us: float, gain_db: float) -> Pair[Command]:
    return Pair(Settings(exposure_us, gain_db), Settings(exposure_us, gain_db))


def test_a_command_reaches_the_next_triggered_frame(open_source: OpenSource) -> None:
    source = open_source()
    for k in range(8):
        asked = Pair(Settings(500.0 + 100 * k, 0.5 * k), Settings(900.0 - 100 * k, 4.0 - 0.5 * k))
        frames = shoot(source, asked)
        assert (frames.primary.used, frames.secondary.used) == asked


def test_settings_hold_until_the_next_command(open_source: OpenSource) -> None:
    source = open_source()
    shoot(source, both(700.0, 3.0))
    for _ in range(3):
        assert all(frame.used == Settings(700.0, 3.0) for frame in shoot(source))


def test_the_last_of_several_commands_counts(open_source: OpenSource) -> None:
    source = open_source()
    source.cameras.primary.apply(Settings(5_000.0, 10.0))
    assert shoot(source, both(600.0, 1.0)).primary.used == Settings(600.0, 1.0)


@pytest.mark.parametrize("latency_frames", [1, 3])
def test_latency_shifts_a_command_by_that_many_frames(
    open_source: OpenSource, latency_frames: int
) -> None:
    source = open_source(latency_frames=latency_frames)
    asked = [both(1_100.0 + 100 * k, k) for k in range(8)]
    shot = [shoot(source, commands) for commands in asked]
    for commands, frames in zip(asked, shot[latency_frames:], strict=False):
        assert (frames.primary.used, frames.secondary.used) == commands
    first = shot[0].primary.used
    assert all(frames.primary.used == first for frames in shot[:latency_frames])


def test_sequence_counts_triggers_from_zero_on_both_sides(open_source: OpenSource) -> None:
    source = open_source()
    for k in range(5):
        frames = shoot(source)
        assert (frames.primary.sequence, frames.secondary.sequence) == (k, k)


def test_both_cameras_expose_at_the_same_instant(open_source: OpenSource) -> None:
    source = open_source()
    for exposures_us in ((100.0, 20_000.0), (20_000.0, 100.0), (900.0, 900.0)):
        commands = Pair(*(Settings(exposure_us, 0.0) for exposure_us in exposures_us))
        frames = shoot(source, commands)
        offset_ns = frames.secondary.device_time_ns - frames.primary.device_time_ns
        assert abs(offset_ns) < 50_000


def test_times_are_on_the_clock_of_the_run_and_never_run_back(open_source: OpenSource) -> None:
    source = open_source()
    last_ns = source.clock.now_ns()
    for _ in range(3):
        frames = shoot(source, both(2_000.0, 0.0))
        for frame in frames:
            assert frame.device_time_ns >= last_ns
            assert frame.host_time_ns >= frame.device_time_ns + 2_000_000
        last_ns = source.clock.now_ns()
        assert last_ns >= frames.secondary.host_time_ns


def test_apply_returns_what_the_frame_says_was_used(open_source: OpenSource) -> None:
    source = open_source()
    primary = source.cameras.primary
    for asked in (Settings(1_234.4, 3.14), Settings(11.6, 0.04), Settings(33.5, 29.96)):
        applied = primary.apply(asked)
        used = shoot(source).primary.used
        assert used == applied
        assert used.exposure_us == round(used.exposure_us)
        assert used.gain_db == round(used.gain_db, 1)
        assert abs(used.exposure_us - asked.exposure_us) <= 0.5
        assert abs(used.gain_db - asked.gain_db) <= 0.05 + 1e-9


def test_settings_out_of_range_are_clamped_and_reported(open_source: OpenSource) -> None:
    source = open_source()
    primary = source.cameras.primary
    lowest = primary.apply(Settings(0.1, 0.0))
    assert lowest == Settings(primary.limits.exposure_us[0], 0.0)
    assert shoot(source).primary.used == lowest
    highest = primary.apply(Settings(100.0, 1_000.0))
    assert isinstance(highest, Settings)
    assert 0 <= primary.limits.gain_db[1] - highest.gain_db < 0.1
    assert shoot(source).primary.used == highest


def test_frames_are_pictures_in_the_said_format(open_source: OpenSource) -> None:
    source = open_source()
    for frame, intrinsics in zip(shoot(source), source.intrinsics, strict=True):
        assert frame.image.shape == (intrinsics.height_px, intrinsics.width_px)
        assert frame.image.dtype == np.uint8
        assert frame.pixel_format == "bayer_rggb8"


def test_more_light_makes_a_brighter_picture(open_source: OpenSource) -> None:
    source = open_source()
    means = [
        shoot(source, both(exposure_us, gain_db)).primary.image.mean()
        for exposure_us, gain_db in ((720.0, 0.0), (2_160.0, 0.0), (2_160.0, 6.0), (6_480.0, 6.0))
    ]
    assert means == sorted(means)
    assert means[-1] > 4 * means[0]


def test_the_two_cameras_see_the_scene_from_two_places(open_source: OpenSource) -> None:
    frames = shoot(open_source(), both(2_000.0, 0.0))
    primary, secondary = (frame.image.astype(float).mean(axis=0) for frame in frames)
    assert np.abs(primary[2:] - secondary[:-2]).mean() < 0.2 * np.abs(primary - secondary).mean()


def test_a_grab_without_a_trigger_times_out(open_source: OpenSource) -> None:
    source = open_source()
    for camera in source.cameras:
        before_ns = source.clock.now_ns()
        with pytest.raises(GrabTimeout, match=camera.serial):
            camera.grab(0.05)
        assert 0.05e9 <= source.clock.now_ns() - before_ns < 1e9


def test_a_pair_after_a_timeout_belongs_together(open_source: OpenSource) -> None:
    source = open_source()
    shoot(source)
    with pytest.raises(GrabTimeout):
        source.cameras.secondary.grab(0.01)
    frames = shoot(source)
    assert frames.primary.sequence == frames.secondary.sequence == 1


def test_the_secondary_takes_no_software_trigger(open_source: OpenSource) -> None:
    source = open_source()
    with pytest.raises(CameraError, match="primary"):
        source.cameras.secondary.trigger()
    assert shoot(source).secondary.sequence == 0


def test_a_closed_camera_says_so(open_source: OpenSource) -> None:
    source = open_source()
    source.close()
    source.close()
    primary = source.cameras.primary
    for use in (primary.trigger, lambda: primary.grab(0.1), lambda: primary.apply(Auto())):
        with pytest.raises(CameraLost, match=primary.serial):
            use()


def test_opening_again_repeats_the_drive(open_source: OpenSource) -> None:
    drives = []
    for _ in range(2):
        source = open_source(seed=3)
        drives.append([shoot(source, both(1_000.0 + k, 6.0)) for k in range(3)])
    for first, second in zip(*drives, strict=True):
        for one, other in zip(first, second, strict=True):
            assert np.array_equal(one.image, other.image)
            assert (one.sequence, one.used) == (other.sequence, other.used)


@pytest.mark.parametrize(
    "open_virtual",
    [open_simulated, pytest.param(open_usb, marks=needs_usb)],
)
def test_opening_again_repeats_even_the_times_on_a_virtual_clock(open_virtual: OpenSource) -> None:
    times_ns = []
    for _ in range(2):
        source = open_virtual(seed=3)
        times_ns.append([[f.device_time_ns for f in shoot(source)] for _ in range(20)])
        source.close()
    assert times_ns[0] == times_ns[1]


def test_every_seed_camera_and_frame_has_its_own_noise(open_source: OpenSource) -> None:
    source = open_source(seed=3, moving=False)
    first, second = (shoot(source, both(1_000.0, 6.0)).primary.image for _ in range(2))
    other = shoot(open_source(seed=4, moving=False), both(1_000.0, 6.0)).primary.image
    assert not np.array_equal(first, second)
    assert not np.array_equal(first, other)


def test_a_picture_does_not_depend_on_when_it_was_triggered(open_source: OpenSource) -> None:
    prompt, late = open_source(), open_source()
    shoot(prompt), shoot(late)
    late.clock.sleep_s(0.7)
    assert np.array_equal(shoot(prompt).primary.image, shoot(late).primary.image)


def test_auto_exposure_converges_on_a_static_scene(open_source: OpenSource) -> None:
    source = open_source(moving=False)
    auto = Auto(target_dn=100.0, start=Settings(100.0, 0.0))
    frames = [shoot(source, Pair(auto, both(500.0, 0.0).secondary)) for _ in range(40)]
    means = [float(pair.primary.image.mean()) for pair in frames]
    assert means[0] < 30
    assert all(abs(mean - 100) < 5 for mean in means[-5:])
    assert frames[0].primary.used == Settings(100.0, 0.0)
    assert frames[-1].secondary.used == Settings(500.0, 0.0)


def test_auto_exposure_stays_inside_its_limits(open_source: OpenSource) -> None:
    source = open_source(moving=False)
    limits = Limits((80.0, 200.0), (0.0, 2.0))
    auto = Auto(limits, target_dn=250.0, start=Settings(100.0, 0.0))
    applied = source.cameras.primary.apply(auto)
    used = [shoot(source, Pair(auto, auto)).primary.used for _ in range(12)]
    assert applied == auto
    assert used[-1] == Settings(200.0, 2.0)
    assert all(80 <= u.exposure_us <= 200 and 0 <= u.gain_db <= 2 for u in used)


@pytest.mark.parametrize("metering", ["lower", "partial", "spot"])
def test_auto_exposure_looks_where_it_is_told(open_source: OpenSource, metering: Metering) -> None:
    source = open_source(moving=False)
    auto = Auto(
        target_dn=100.0,
        damping=0.0,
        start=Settings(5_000.0, 12.0),
        metering=metering,
        priority="exposure",
    )
    assert source.cameras.primary.apply(auto) == auto
    for _ in range(20):
        image = shoot(source, Pair(auto, auto)).primary.image
    assert metered_dn(image, metering) == pytest.approx(100, abs=5)


def test_auto_exposure_starts_again_after_other_settings(open_source: OpenSource) -> None:
    source = open_source(moving=False)
    auto = Auto(start=Settings(100.0, 0.0))
    for _ in range(5):
        learnt = shoot(source, Pair(auto, auto)).primary.used
    assert learnt.exposure_us > 100
    shoot(source, both(400.0, 0.0))
    assert shoot(source, Pair(auto, auto)).primary.used == Settings(100.0, 0.0)


def test_the_source_describes_its_drive(open_source: OpenSource) -> None:
    source = open_source()
    assert source.drive_triggers == 30
    assert source.rate_hz == 10.0
    assert source.pose_index(7) == 7
    truth = source.truth(5)
    assert truth is not None
    assert truth.position_m[0] == pytest.approx(10.0)
