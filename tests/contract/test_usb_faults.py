"""Aravis' own USB3 Vision code under our driver: what goes wrong, and what names it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from served_pair import plane_plan
from usb3.opening import needs_usb, plugged
from usb3.pair import UsbPair, look_at_usb, reach_as_it_runs, reach_in_step

from rig.cli.drive import make_header
from rig.controllers.policies import RacePolicy
from rig.controllers.registry import make_controller
from rig.core.clock import SystemClock
from rig.core.errors import CameraError
from rig.core.types import Frame, Pair, Settings
from rig.drivers.aravis import binding
from rig.drivers.aravis.binding import open_camera
from rig.drivers.aravis.session import PairSpec
from rig.drivers.aravis.source import AravisSource, Surroundings, open_pair
from rig.drivers.connected import Connected
from rig.loop import run_pair
from rig.pair import CameraPair, PairShot
from rig.record.reader import open_recording
from rig.record.verify import verify
from rig.record.writer import RecordWriter

pytestmark = needs_usb

Rig = tuple[CameraPair, UsbPair, AravisSource]
OpenRig = Callable[..., Rig]


@pytest.fixture
def open_rig() -> Iterator[OpenRig]:
    """Plug a pair in and open it on its virtual clock; everything is closed after the test."""
    with ExitStack() as stack:

        def opener(**plan: object) -> Rig:
            pair = stack.enter_context(plugged(plane_plan(**plan)))
            spec = PairSpec(pair.labels, rate_hz=None)
            source = open_pair(spec, Surroundings("usb:test"), reach=reach_in_step(pair))
            stack.callback(source.close)
            return CameraPair(source), pair, source

        yield opener


@pytest.fixture
def pair() -> Iterator[UsbPair]:
    with plugged(plane_plan()) as plugged_in:
        look_at_usb(plugged_in.labels)
        yield plugged_in


def settings(exposure_us: float = 2_000.0) -> Pair[Settings]:
    return Pair(Settings(exposure_us, 1.0), Settings(exposure_us, 2.0))


def assert_whole(shot: PairShot, trigger: int) -> None:
    assert shot.cause == ""
    assert [frame.sequence for frame in shot.frames] == [trigger, trigger]


def test_pairs_are_whole_and_take_what_was_asked(open_rig: OpenRig) -> None:
    rig, _, _ = open_rig()
    for k in range(60):
        commands = Pair(Settings(500.0 + k, k % 20), Settings(900.0 - k, (k + 7) % 20))
        rig.apply(commands)
        shot = rig.shoot()
        assert_whole(shot, k)
        assert Pair(*(frame.used for frame in shot.frames)) == commands
        assert shot.offset_ns == 8_000


@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        ("lose_edges", "secondary: no edge on the trigger wire"),
        ("ignore_triggers", "secondary: trigger ignored by the camera"),
        ("lose_pictures", "secondary: exposed, but the picture did not come"),
    ],
)
def test_a_lost_secondary_is_named_and_shifts_nothing(
    open_rig: OpenRig, fault: str, cause: str
) -> None:
    rig, pair, _ = open_rig()
    rig.apply(settings())
    setattr(pair.cameras.secondary.faults, fault, 1)
    assert rig.shoot().cause == cause
    assert_whole(rig.shoot(), 1)


def test_a_picture_that_is_cut_short_is_refused(open_rig: OpenRig) -> None:
    rig, pair, _ = open_rig()
    pair.cameras.primary.short_pictures = 1
    assert rig.shoot().cause == "primary: picture incomplete (size mismatch)"
    assert_whole(rig.shoot(), 1)


def test_both_cameras_are_rebuilt_when_one_is_plugged_in_again(open_rig: OpenRig) -> None:
    rig, pair, source = open_rig()
    rig.apply(settings())
    assert_whole(rig.shoot(), 0)
    secondary = pair.cameras.secondary
    secondary.plug.pull()
    assert rig.shoot().cause.endswith("secondary: camera lost, segment 1 ended")
    secondary.wake_up()
    secondary.plug.push()
    for _ in range(20):
        rig.apply(settings(700.0))
        shot = rig.shoot()
        if not shot.cause:
            break
        assert set(shot.cause.split("; ")) <= {
            "primary: camera lost, segment 1 ended",
            "secondary: camera lost, segment 1 ended",
        }
    assert_whole(shot, rig.triggers - 1)
    assert [frame.used for frame in shot.frames] == list(settings(700.0))
    assert source.segments.number == 2


def test_settings_that_come_late_are_never_claimed(open_rig: OpenRig) -> None:
    rig, _, _ = open_rig(latency_frames=2)
    rig.apply(settings(1_500.0))
    used = [rig.shoot().frames.primary.used.exposure_us for _ in range(4)]
    assert used == [1_000.0, 1_000.0, 1_500.0, 1_500.0]


def test_a_missing_node_is_named(open_rig: OpenRig) -> None:
    with pytest.raises(CameraError, match="01170163: has no node ExposureTime, which a Blackfly S"):
        open_rig(hidden=frozenset({"ExposureTime"}))


@pytest.mark.parametrize("label", ["18284899", "01170163"])
def test_a_camera_is_opened_by_either_form_of_its_serial_number(pair: UsbPair, label: str) -> None:
    opened = open_camera(label)
    assert opened.serial == "01170163"
    opened.close(say_goodbye=True)


def test_what_was_opened_before_a_camera_left_stays_dead(pair: UsbPair) -> None:
    primary, before = pair.cameras.primary, open_camera(pair.labels.primary)
    primary.plug.pull()
    primary.wake_up()
    primary.plug.push()
    look_at_usb(pair.labels)
    after = open_camera(pair.labels.primary)
    after.nodes.write("Gain", 4.0)
    with pytest.raises(CameraError, match="01170163: writing Gain"):
        before.nodes.write("Gain", 8.0)
    assert after.nodes.read("Gain") == 4.0
    for opened in (before, after):
        opened.close(say_goodbye=True)


def test_a_setting_out_of_range_is_refused_by_the_camera(pair: UsbPair) -> None:
    opened = open_camera(pair.labels.primary)
    with pytest.raises(
        CameraError, match=r"01170163: writing ExposureTime = 1000000000000\.0: .*invalid"
    ):
        opened.nodes.write("ExposureTime", 1e12)
    opened.close(say_goodbye=True)


def test_a_camera_in_use_is_refused(pair: UsbPair) -> None:
    opened = open_camera(pair.labels.primary)
    with pytest.raises(CameraError, match="18284899: another program controls this camera"):
        open_camera(pair.labels.primary)
    opened.close(say_goodbye=True)


def test_a_camera_that_may_not_be_opened_is_told_from_one_that_is_not_there(
    pair: UsbPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair.cameras.primary.plug.forbid(True)
    look_at_usb(pair.labels)
    with pytest.raises(
        CameraError, match=r"18284899: no such camera; found .*01170164.*; check cable"
    ):
        open_camera(pair.labels.primary)
    seen = [Connected("01170163", "Blackfly S", "usb")]
    monkeypatch.setattr(binding, "usb_cameras", lambda: seen)
    with pytest.raises(CameraError, match=r"18284899: is on USB and may not .* --install-udev"):
        open_camera(pair.labels.primary)


def test_the_pair_also_runs_by_the_computers_clock() -> None:
    pair = UsbPair(plane_plan(), SystemClock())
    going = threading.Event()
    going.set()
    runner = threading.Thread(target=pair.run, args=(going.is_set,))
    runner.start()
    try:
        spec = PairSpec(pair.labels, rate_hz=None)
        reach = reach_as_it_runs(pair)
        with closing(open_pair(spec, Surroundings("usb:test"), reach=reach)) as source:
            rig = CameraPair(source)
            for k in range(5):
                rig.apply(settings(1_000.0 + k))
                for frame, asked in zip(rig.shoot().frames, settings(1_000.0 + k), strict=True):
                    assert isinstance(frame, Frame)
                    assert (frame.sequence, frame.used) == (k, asked)
    finally:
        going.clear()
        runner.join()
        pair.close()


def test_a_recording_shows_where_a_segment_ended(open_rig: OpenRig, tmp_path: Path) -> None:
    _, pair, source = open_rig()
    fixed = (
        make_controller("fixed:exposure_us=900,gain_db=0", seed=0, networks={}) for _ in range(2)
    )
    header = make_header(source, 0, Pair("fixed", "fixed"), {}, {})

    def keep_going(done: int) -> bool:
        secondary = pair.cameras.secondary
        if done == 5:
            secondary.plug.pull()
        if done == 8:
            secondary.wake_up()
            secondary.plug.push()
        return done < 20

    with RecordWriter(tmp_path / "run", header, real_time=False) as recorder:
        run_pair(source, RacePolicy(*fixed, source.clock), recorder, keep_going)
    found = verify(tmp_path / "run")
    assert found.sound
    assert found.pairs + sum(found.lost.values()) == 20
    assert all(cause.endswith("camera lost, segment 1 ended") for cause in found.lost)
    first, *_, last = [r.trigger for r in open_recording(tmp_path / "run").records() if r.cause]
    assert (first, last - first + 1) == (5, sum(found.lost.values()))
    assert found.pairs >= 14
