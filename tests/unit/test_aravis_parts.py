"""The parts of the driver that need no camera: clocks, triggers, memory, serial numbers."""

from __future__ import annotations

import gc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.core.clock import VirtualClock
from rig.drivers.aravis import binding
from rig.drivers.aravis.address import read_spec
from rig.drivers.aravis.camera import steps_between
from rig.drivers.aravis.ring import KEPT_BACK, RING_PICTURES, Ring
from rig.drivers.aravis.serials import same_serial
from rig.drivers.aravis.times import MAX_CLOCK_ERROR_NS, REFIT_NS, ClockFit, TriggerLog


@pytest.mark.parametrize(
    ("label", "told", "same"),
    [
        ("18284899", "18284899", True),
        ("18284899", "01170163", True),
        ("01170163", "18284899", True),
        ("18284899", "18284900", False),
        ("SIM-PRIMARY", "sim-primary", True),
        ("SIM-PRIMARY", "SIM-SECONDARY", False),
        ("", "0", False),
    ],
)
def test_a_serial_number_is_known_in_both_forms(label: str, told: str, same: bool) -> None:
    assert same_serial(label, told) is same


@given(last=st.integers(0, 0xFFFF), step=st.integers(1, 1000))
def test_ids_of_16_bits_count_on_over_their_end(last: int, step: int) -> None:
    from_zero = (last + step) % 0x10000
    found = steps_between(last, from_zero)
    assert found == step or (last + step > 0xFFFF and found == max(step - 1, 1))


def test_an_id_that_stands_still_or_runs_back_is_no_step() -> None:
    assert steps_between(5, 5) == 0
    assert steps_between(1 << 40, (1 << 40) - 3) < 0


def test_a_picture_belongs_to_the_last_trigger_before_it() -> None:
    log = TriggerLog()
    for k in range(3):
        log.fired(k * 100_000_000, k * 100_000_000 + 300_000)
    assert log.sequence_of(100_000_000 - MAX_CLOCK_ERROR_NS) == 1
    assert log.sequence_of(100_000_000 - MAX_CLOCK_ERROR_NS - 1) == 0
    assert log.sequence_of(199_000_000 - 1) == 1
    assert log.sequence_of(10_000_000_000) == 2
    assert log.sequence_of(-MAX_CLOCK_ERROR_NS - 1) is None


def test_a_clock_that_is_known_badly_leaves_more_room_before_a_trigger() -> None:
    log, free = TriggerLog(), TriggerLog(by_trigger=False)
    for each in (log, free):
        each.fired(100_000_000, 100_300_000)
    assert log.sequence_of(97_000_000) is None
    assert log.sequence_of(97_000_000, error_ns=3_000_000) == 0
    assert free.sequence_of(99_999_999, error_ns=3_000_000) is None


def test_triggers_that_could_not_be_fired_are_counted() -> None:
    log = TriggerLog()
    log.fired(0, 1)
    log.passed()
    log.fired(200_000_000, 200_000_001)
    assert log.sequence_of(200_000_000) == 2


def test_the_best_look_gives_the_offset_and_its_error() -> None:
    clock = VirtualClock()
    looks = iter([(0, 0, 900_000), (10**6, 12_000, 10**6 + 400_000), (2 * 10**6, 1, 5 * 10**6)])
    fit = ClockFit(clock, lambda: next(looks))
    fit.refit(tries=3)
    assert fit.to_host_ns(12_000) == 1_200_000
    assert fit.error_ns == 200_000


def test_a_clock_is_measured_again_when_the_fit_is_old() -> None:
    clock = VirtualClock()
    drift = 2e-5

    def latch() -> tuple[int, int, int]:
        now_ns = clock.now_ns()
        return now_ns, round(now_ns * (1 + drift)) + 77, now_ns

    fit = ClockFit(clock, latch)
    fit.keep_fresh()
    for _ in range(100):
        clock.sleep_s(0.5)
        fit.keep_fresh()
        _, device_ns, _ = latch()
        assert abs(fit.to_host_ns(device_ns) - clock.now_ns()) <= drift * (REFIT_NS + 5e8) + 1


def test_a_slow_look_does_not_spoil_a_good_fit() -> None:
    clock = VirtualClock()
    looks = iter([(0, 0, 100), *[(5_000_000_000, 5_001_000_000, 5_004_000_000)] * 2])
    fit = ClockFit(clock, lambda: next(looks))
    fit.refit(tries=30)
    clock.sleep_s(5.0)
    fit.keep_fresh()
    assert (fit.offset_ns, fit.error_ns) == (50, 50)


class Slots:
    """Counts what a ring gives back."""

    def __init__(self) -> None:
        self.back: list[int] = []
        self.ring = Ring(64, self.back.append)


def test_a_picture_is_lent_without_a_copy_until_its_last_view_is_gone() -> None:
    slots = Slots()
    image = slots.ring.take(2, 48).reshape(6, 8)
    assert image.ctypes.data == slots.ring.address(2)
    part = image[1:3, ::2]
    del image
    gc.collect()
    assert slots.back == []
    del part
    gc.collect()
    assert slots.back == [2]
    assert slots.ring.lent == 0


def test_the_camera_never_runs_dry() -> None:
    slots = Slots()
    kept = [slots.ring.take(slot, 64) for slot in range(RING_PICTURES)]
    lent = RING_PICTURES - KEPT_BACK
    assert slots.ring.lent == lent
    assert slots.back == list(range(lent, RING_PICTURES))
    assert all(isinstance(image, np.ndarray) for image in kept)


def test_the_slot_of_the_latest_picture_rests_until_the_next_one() -> None:
    slots = Slots()
    slots.ring.arrived(3)
    slots.ring.give_back(3)
    assert slots.back == []
    slots.ring.arrived(4)
    assert slots.back == [3]
    image = slots.ring.take(4, 64)
    slots.ring.arrived(5)
    assert slots.back == [3]
    del image
    gc.collect()
    assert slots.back == [3, 4]


def test_a_closed_ring_keeps_what_is_looked_at() -> None:
    slots = Slots()
    image = slots.ring.take(0, 64)
    slots.ring.close()
    image_before = image.copy()
    assert np.array_equal(image, image_before)
    del image
    gc.collect()
    assert slots.back == []


def test_an_address_says_how_the_pair_runs() -> None:
    spec = read_spec("18284899, 01170164", {"mode": "free-run", "rate_hz": "20"})
    assert spec.names == ("18284899", "01170164")
    assert (spec.mode, spec.rate_hz) == ("free-run", 20.0)
    assert read_spec("1,2", {"rate_hz": "max"}).rate_hz is None
    assert read_spec("1,2", {"link_bytes_per_s": "90000000"}).setup.link_bytes_per_s == 90_000_000


class HeldDevice:
    """A device that Aravis' own thread holds for a while, as when it tells of a loss."""

    def __init__(self, looks: int) -> None:
        self.looks = looks

    @property
    def __grefcount__(self) -> int:
        self.looks -= 1
        return 2 if self.looks > 0 else 1


def test_a_device_is_let_go_when_nobody_else_holds_it(monkeypatch: pytest.MonkeyPatch) -> None:
    device, last = HeldDevice(looks=4), [None, object()]
    last.append(device)
    binding._let_go(last)
    assert device.looks == 0 and last == []
    monkeypatch.setattr(binding, "_LONGEST_HOLD_S", 0.01)
    forever = HeldDevice(looks=1_000_000)
    binding._let_go([None, object(), forever])
    assert forever.looks > 0
