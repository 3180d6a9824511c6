"""What goes wrong with cameras on the network, injected, and the one line that names it."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from served_pair import needs_aravis, plane_plan, served

from rig.core.errors import CameraError, CameraLost
from rig.core.types import Frame, Lost, Pair, Settings
from rig.drivers.aravis.binding import open_camera
from rig.drivers.aravis.session import PairSpec
from rig.drivers.aravis.source import AravisSource, Surroundings, open_pair
from rig.drivers.simulated.gige.server import Server
from rig.pair import CameraPair, PairShot

pytestmark = needs_aravis

SMALL_PACKET_BYTES = 640
"""So that one picture takes several packets."""

Rig = tuple[CameraPair, Server, AravisSource]
OpenRig = Callable[..., Rig]


@pytest.fixture
def open_rig() -> Iterator[OpenRig]:
    """Serve a pair and open it; everything is closed after the test."""
    with ExitStack() as stack:

        def opener(*, swap: bool = False, invert: bool = False, **plan: object) -> Rig:
            server = stack.enter_context(served(plane_plan(**plan)))
            if invert:
                invert_wire(server)
            addresses = Pair(*reversed(server.addresses)) if swap else server.addresses
            spec = PairSpec(addresses, rate_hz=None, packet_bytes=SMALL_PACKET_BYTES)
            source = open_pair(spec, Surroundings("gige:test"))
            stack.callback(source.close)
            return CameraPair(source), server, source

        yield opener


def invert_wire(server: Server) -> None:
    edge_in = server.devices.secondary.edge_in
    server.devices.primary.output_wires[1] = [
        lambda rising, time_ns, sequence: edge_in(not rising, time_ns, sequence)
    ]


def sequences(shot: PairShot) -> tuple[int, int]:
    assert shot.cause == ""
    return shot.frames.primary.sequence, shot.frames.secondary.sequence


def settings(exposure_us: float = 2_000.0) -> Pair[Settings]:
    return Pair(Settings(exposure_us, 1.0), Settings(exposure_us, 2.0))


def assert_only_this_pair_is_lost(pair: CameraPair, cause: str) -> PairShot:
    """Shoot a pair that loses a frame by `cause`, then one that is whole and numbered right."""
    shot = pair.shoot()
    assert shot.cause == cause
    assert shot.offset_ns is None
    following = pair.shoot()
    assert sequences(following) == (pair.triggers - 1,) * 2
    return shot


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
    pair, server, _ = open_rig()
    pair.apply(settings())
    assert sequences(pair.shoot()) == (0, 0)
    setattr(server.devices.secondary.faults, fault, 1)
    shot = assert_only_this_pair_is_lost(pair, cause)
    assert isinstance(shot.frames.primary, Frame)
    assert isinstance(shot.frames.secondary, Lost)


def test_a_trigger_that_the_primary_ignores_loses_both(open_rig: OpenRig) -> None:
    pair, server, _ = open_rig()
    server.devices.primary.faults.ignore_triggers = 1
    ignored, no_edge = "trigger ignored by the camera", "no edge on the trigger wire"
    assert_only_this_pair_is_lost(pair, f"primary: {ignored}; secondary: {no_edge}")


def test_packets_that_get_lost_or_overtake_are_mended(open_rig: OpenRig) -> None:
    pair, server, _ = open_rig(seed=3)
    pair.apply(settings())
    whole = pair.shoot()
    for device in server.devices:
        device.faults.lose_packets = 2
        device.faults.reorder_packets = True
    mended = pair.shoot()
    assert sequences(mended) == (1, 1)
    assert server.devices.primary.faults.lose_packets == 0
    assert mended.frames.primary.image.mean() == pytest.approx(
        whole.frames.primary.image.mean(), rel=0.05
    )


def test_a_picture_with_holes_is_refused(open_rig: OpenRig) -> None:
    pair, server, _ = open_rig()
    server.devices.primary.faults.refuse_resend = True
    server.devices.primary.faults.lose_packets = 2
    assert_only_this_pair_is_lost(pair, "primary: picture incomplete (packets missing)")


def test_both_cameras_are_rebuilt_when_one_comes_back(
    open_rig: OpenRig, caplog: pytest.LogCaptureFixture
) -> None:
    pair, server, source = open_rig()
    pair.apply(settings())
    assert sequences(pair.shoot()) == (0, 0)
    server.devices.secondary.faults.unplugged = True
    lost = pair.shoot()
    assert lost.cause.endswith("secondary: camera lost, segment 1 ended")
    server.devices.secondary.faults.unplugged = False
    time.sleep(0.1)
    shots = shots_until_whole(pair, settings(700.0))
    assert sequences(shots[-1]) == (pair.triggers - 1,) * 2
    assert {shot.cause for shot in shots[:-1]} <= {
        "primary: camera lost, segment 1 ended; secondary: camera lost, segment 1 ended"
    }
    assert shots[-1].frames.secondary.used == settings(700.0).secondary
    assert source.segments.number == 2
    assert "both cameras are back; segment 2 begins" in caplog.text


def shots_until_whole(pair: CameraPair, commands: Pair[Settings]) -> list[PairShot]:
    shots = []
    for _ in range(20):
        pair.apply(commands)
        shots.append(pair.shoot())
        if not shots[-1].cause:
            return shots
    raise AssertionError(shots[-1].cause)


def test_a_camera_that_drops_its_client_ends_the_segment(open_rig: OpenRig) -> None:
    pair, server, source = open_rig()
    pair.apply(settings())
    pair.shoot()
    server.devices.primary.faults.drop_control = True
    time.sleep(0.2)
    assert "primary: camera lost, segment 1 ended" in pair.shoot().cause
    shots = shots_until_whole(pair, settings())
    assert sequences(shots[-1]) == (pair.triggers - 1,) * 2
    assert source.segments.number == 2


@pytest.mark.parametrize("side", ["primary", "secondary"])
def test_control_that_is_gone_when_the_clock_is_looked_at_ends_the_segment(
    open_rig: OpenRig, monkeypatch: pytest.MonkeyPatch, side: str
) -> None:
    pair, server, source = open_rig()
    pair.apply(settings())
    pair.shoot()
    monkeypatch.setattr("rig.drivers.aravis.times.REFIT_NS", 0)
    getattr(server.devices, side).faults.drop_control = True
    time.sleep(0.2)
    assert "camera lost, segment 1 ended" in pair.shoot().cause
    shots_until_whole(pair, settings())
    assert source.segments.number == 2


def test_cameras_that_stay_away_end_the_run(
    open_rig: OpenRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.drivers.aravis.source.GIVE_UP_S", 0.0)
    pair, server, _ = open_rig()
    server.devices.primary.faults.drop_control = True
    time.sleep(0.2)
    pair.shoot()
    server.devices.primary.faults.unplugged = True
    time.sleep(0.6)
    with pytest.raises(CameraLost, match="SIM-PRIMARY: gone for over 0 s"):
        pair.apply(settings())


def test_a_camera_in_use_is_refused(open_rig: OpenRig) -> None:
    _, server, _ = open_rig()
    with pytest.raises(CameraError, match=rf"{server.addresses.primary}: another program controls"):
        open_camera(server.addresses.primary)


def test_a_camera_that_is_not_there_is_named() -> None:
    with pytest.raises(CameraError, match=r"99999999: no such camera; found .*check cable"):
        open_camera("99999999")


def test_a_missing_node_is_named(open_rig: OpenRig) -> None:
    with pytest.raises(CameraError, match="SIM-PRIMARY: has no node ExposureTime, which a Blackf"):
        open_rig(hidden=frozenset({"ExposureTime"}))


def test_nodes_that_may_be_missing_are_passed_over(open_rig: OpenRig) -> None:
    pair, _, _ = open_rig(
        hidden=frozenset({"GammaEnable", "BlackLevel", "CounterSelector", "TriggerDelay"})
    )
    assert sequences(pair.shoot()) == (0, 0)


def test_an_inverted_edge_is_found_when_opening(open_rig: OpenRig) -> None:
    with pytest.raises(CameraError, match="SIM-SECONDARY: began when the primary's exposure ended"):
        open_rig(invert=True)


def test_an_edge_that_becomes_inverted_breaks_the_pair(open_rig: OpenRig) -> None:
    pair, server, _ = open_rig()
    pair.apply(settings())
    pair.shoot()
    invert_wire(server)
    shot = pair.shoot()
    assert shot.cause == (
        "secondary: began as the primary's exposure ended (inverted trigger edge)"
    )


def test_swapped_cameras_are_found_when_opening(open_rig: OpenRig) -> None:
    with pytest.raises(
        CameraError,
        match=r"SIM-PRIMARY: no picture when SIM-SECONDARY exposed: no edge on the trigger wire.*"
        r"or swap the two in --cameras",
    ):
        open_rig(swap=True)


def test_settings_that_come_late_are_said_and_never_claimed(
    open_rig: OpenRig, caplog: pytest.LogCaptureFixture
) -> None:
    pair, _, _ = open_rig(latency_frames=2)
    pair.apply(settings(1_500.0))
    with caplog.at_level(logging.WARNING):
        used = [pair.shoot().frames.primary.used.exposure_us for _ in range(4)]
    assert used == [1_000.0, 1_000.0, 1_500.0, 1_500.0]
    assert "SIM-PRIMARY: settings came late: trigger 0 used 1000 us 0 dB, not 1500" in caplog.text


def test_ids_that_begin_again_lose_nothing(
    open_rig: OpenRig, caplog: pytest.LogCaptureFixture
) -> None:
    pair, _, _ = open_rig(short_ids=True, first_id=65_532)
    with caplog.at_level(logging.INFO):
        assert [sequences(pair.shoot()) for _ in range(6)] == [(k, k) for k in range(6)]
    assert "did not come" not in caplog.text
