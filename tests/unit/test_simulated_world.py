"""Events, wires and the shared cable."""

from __future__ import annotations

import pytest

from rig.core.clock import SystemClock, VirtualClock
from rig.drivers.simulated.world import Link, Wire, World


def test_events_happen_in_order_of_time_then_of_planning() -> None:
    world = World(VirtualClock())
    seen: list[tuple[str, int]] = []
    for name, time_ns in (("late", 30), ("a", 10), ("b", 10), ("mid", 20)):
        world.at(time_ns, lambda now_ns, name=name: seen.append((name, now_ns)))
    assert not world.run_until(lambda: False, deadline_ns=25)
    assert seen == [("a", 10), ("b", 10), ("mid", 20)]
    assert world.clock.now_ns() == 25


def test_an_event_that_is_run_late_sees_its_own_time() -> None:
    world = World(VirtualClock())
    seen: list[int] = []
    world.at(10, seen.append)
    world.clock.sleep_s(1e-6)
    world.catch_up()
    assert seen == [10]
    assert world.clock.now_ns() == 1_000


def test_waiting_stops_as_soon_as_it_is_done() -> None:
    world = World(VirtualClock())
    seen: list[int] = []
    world.at(10, lambda now_ns: world.at(now_ns + 5, seen.append))
    world.at(100, seen.append)
    assert world.run_until(lambda: bool(seen), deadline_ns=1_000)
    assert seen == [15]
    assert world.clock.now_ns() == 15


def test_a_real_clock_is_waited_for() -> None:
    clock = SystemClock()
    world = World(clock)
    start_ns = clock.now_ns()
    seen: list[int] = []
    world.at(start_ns + 5_000_000, seen.append)
    assert world.run_until(lambda: bool(seen), deadline_ns=start_ns + 1_000_000_000)
    assert clock.now_ns() - start_ns >= 5_000_000


def test_a_wire_carries_the_edge_and_its_number() -> None:
    world = World(VirtualClock())
    seen: list[tuple[int, int]] = []
    wire = Wire(world, delay_ns=8, inputs=[lambda *edge: seen.append(edge)])
    wire.rise(100, 4)
    world.run_until(lambda: bool(seen), deadline_ns=1_000)
    assert seen == [(108, 4)]


def test_the_cable_carries_one_picture_after_the_other() -> None:
    world = World(VirtualClock())
    link = Link(world, bytes_per_s=1e9)
    over: list[int] = []
    for ready_ns in (0, 10, 5_000):
        link.send(1_000, ready_ns, over.append)
    world.run_until(lambda: len(over) == 3, deadline_ns=100_000)
    assert over == pytest.approx([1_000, 2_000, 6_000])
