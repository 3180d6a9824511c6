"""The timing of the simulated pair: who is ready when, and what a missed trigger leaves."""

from __future__ import annotations

import re

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.config import load_camera_model
from rig.core.clock import VirtualClock
from rig.core.errors import GrabTimeout
from rig.core.types import Pair, Settings
from rig.drivers.simulated.camera import Overlap, SimulatedCamera, Wiring
from rig.drivers.simulated.world import Link, Wire, World

MODEL = load_camera_model("blackfly-s-u3-31s4")
READOUT_NS = round(MODEL.timing.readout_s * 1e9)
FULL_SIZE = (MODEL.picture.height_px, MODEL.picture.width_px)


def numbered(sequence: int, used: Settings) -> NDArray[np.uint8]:
    return np.full((4, 6), sequence, np.uint8)


def full_size(sequence: int, used: Settings) -> NDArray[np.uint8]:
    return np.zeros(FULL_SIZE, np.uint8)


def single(overlap: Overlap = "off", picture=numbered) -> SimulatedCamera:
    world = World(VirtualClock())
    wiring = Wiring(world, Link(world, 190e6), Wire(world, 0), True, overlap)
    return SimulatedCamera("CAM", MODEL, wiring, picture)


def wired(picture=numbered) -> tuple[World, Pair[SimulatedCamera]]:
    world = World(VirtualClock())
    link, wire = Link(world, MODEL.timing.link_bytes_per_s), Wire(world, 8_000)
    primary = SimulatedCamera("P", MODEL, Wiring(world, link, wire, True, "off"), picture)
    deaf = Wiring(world, link, Wire(world, 0), False, "readout")
    secondary = SimulatedCamera("S", MODEL, deaf, picture)
    wire.inputs.append(secondary.on_trigger)
    return world, Pair(primary, secondary)


def test_a_frame_takes_exposure_readout_transfer_and_delivery() -> None:
    camera = single()
    camera.apply(Settings(5_000.0, 0.0))
    camera.trigger()
    frame = camera.grab(1.0)
    transfer_ns = round(frame.image.nbytes / 190e6 * 1e9)
    delivery_ns = round(MODEL.timing.delivery_s * 1e9)
    assert frame.device_time_ns == 0
    assert frame.host_time_ns == pytest.approx(
        5_000_000 + READOUT_NS + transfer_ns + delivery_ns, abs=3
    )


@pytest.mark.parametrize(
    ("wait_s", "busy"), [(0.0, "exposure"), (0.004, "exposure"), (0.006, "readout")]
)
def test_a_trigger_to_a_busy_camera_is_ignored_and_leaves_a_cause(wait_s: float, busy: str) -> None:
    camera = single()
    camera.apply(Settings(5_000.0, 0.0))
    camera.trigger()
    camera._wiring.world.clock.sleep_s(wait_s)
    camera.trigger()
    assert camera.grab(1.0).sequence == 0
    with pytest.raises(GrabTimeout, match=r"CAM: .*\(trigger 1\)") as caught:
        camera.grab(1.0)
    assert caught.value.cause == f"trigger ignored during {busy}"
    assert camera.ignored_triggers == 1
    camera.trigger()
    assert camera.grab(1.0).sequence == 2
    with pytest.raises(GrabTimeout, match="no trigger under way"):
        camera.grab(1.0)


def test_readout_overlap_exposes_while_the_last_picture_is_read() -> None:
    camera = single(overlap="readout")
    camera.apply(Settings(5_000.0, 0.0))
    for _ in range(2):
        camera.trigger()
        camera._wiring.world.clock.sleep_s(0.006)
    first, second = camera.grab(1.0), camera.grab(1.0)
    assert second.device_time_ns == 6_000_000 < first.device_time_ns + 5_000_000 + READOUT_NS
    assert second.host_time_ns - first.host_time_ns >= READOUT_NS
    assert camera.ignored_triggers == 0


def test_the_secondary_ignores_the_edge_while_it_exposes() -> None:
    _, cameras = wired()
    cameras.primary.apply(Settings(100.0, 0.0))
    cameras.secondary.apply(Settings(200_000.0, 0.0))
    for sequence in (0, 1):
        cameras.primary.trigger()
        assert cameras.primary.grab(1.0).sequence == sequence
    assert cameras.secondary.grab(1.0).sequence == 0
    with pytest.raises(GrabTimeout, match=r"S: .*trigger ignored during exposure"):
        cameras.secondary.grab(1.0)
    cameras.primary.trigger()
    assert (cameras.primary.grab(1.0).sequence, cameras.secondary.grab(1.0).sequence) == (2, 2)


def test_an_edge_lost_at_the_primary_reaches_no_secondary() -> None:
    _, cameras = wired()
    cameras.primary.trigger()
    cameras.primary.trigger()
    assert cameras.secondary.grab(1.0).sequence == 0
    with pytest.raises(GrabTimeout, match="no trigger under way"):
        cameras.secondary.grab(1.0)
    cameras.primary.trigger()
    assert cameras.secondary.grab(1.0).sequence == 2


def test_the_secondary_starts_by_the_delay_of_the_wire_later() -> None:
    _, cameras = wired()
    cameras.primary.trigger()
    starts_ns = [camera.grab(1.0).device_time_ns for camera in cameras]
    assert starts_ns[1] - starts_ns[0] == 8_000


def test_a_time_out_before_the_end_of_the_exposure_says_so() -> None:
    camera = single()
    camera.apply(Settings(500_000.0, 0.0))
    camera.trigger()
    with pytest.raises(GrabTimeout, match=re.escape("no frame within 0.1 s; exposure not over")):
        camera.grab(0.1)
    assert camera.grab(1.0).sequence == 0


def test_full_size_pairs_at_30_ms_come_at_about_10_hz() -> None:
    """Exposure-following mode reaches ~10 Hz at the longest exposure (thesis 5.1.1)."""
    world, cameras = wired(full_size)
    for camera in cameras:
        camera.apply(Settings(30_000.0, 0.0))
    for _ in range(5):
        cameras.primary.trigger()
        for camera in cameras:
            camera.grab(1.0)
    period_s = world.clock.now_ns() / 5e9
    assert 1 / period_s == pytest.approx(10.0, rel=0.03)


def test_a_shorter_exposure_makes_a_faster_pair() -> None:
    world, cameras = wired(full_size)
    cameras.primary.trigger()
    for camera in cameras:
        camera.grab(1.0)
    assert world.clock.now_ns() < 75e6


def test_two_cameras_of_one_cable_share_it() -> None:
    slow = msgspec.structs.replace(
        MODEL, timing=msgspec.structs.replace(MODEL.timing, delivery_s=0.0)
    )
    world = World(VirtualClock())
    link, wire = Link(world, 24e3), Wire(world, 0)
    primary = SimulatedCamera("P", slow, Wiring(world, link, wire, True, "off"), numbered)
    deaf = Wiring(world, link, Wire(world, 0), False, "readout")
    secondary = SimulatedCamera("S", slow, deaf, numbered)
    wire.inputs.append(secondary.on_trigger)
    primary.trigger()
    arrivals_ns = [camera.grab(1.0).host_time_ns for camera in (primary, secondary)]
    assert arrivals_ns[1] - arrivals_ns[0] == 1_000_000
