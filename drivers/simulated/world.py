"""Things that happen in time: events, the wires between cameras and the cable to the computer."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from rig.core.protocols import Clock
from rig.core.units import NS_PER_S, s_to_ns

Event = Callable[[int], None]
"""What happens; it is told the time in nanoseconds."""


class World:
    """Events in order of their time, on a virtual or a real clock.

    Nothing happens on its own: whoever waits for something runs the events up to it. An event sees
    the time at which it is due, however late it is run, so results do not depend on the caller.
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self._events: list[tuple[int, int, Event]] = []
        self._planned = 0

    @property
    def next_ns(self) -> int | None:
        """Return when the next event is due; None when nothing is planned."""
        return self._events[0][0] if self._events else None

    def at(self, time_ns: int, event: Event) -> None:
        """Plan `event` for `time_ns`; events of one time happen in the order of planning."""
        heapq.heappush(self._events, (time_ns, self._planned, event))
        self._planned += 1

    def catch_up(self) -> None:
        """Let everything happen that is due by now; what comes due meanwhile is left."""
        now_ns = self.clock.now_ns()
        while self._events and self._events[0][0] <= now_ns:
            self._happen()

    def run_until(self, done: Callable[[], bool], deadline_ns: int) -> bool:
        """Let time pass until `done()`; return False when the deadline came first."""
        self.catch_up()
        while not done():
            if not self._events or self._events[0][0] > deadline_ns:
                self._wait_until(deadline_ns)
                return False
            self._wait_until(self._events[0][0])
            self._happen()
        return True

    def _happen(self) -> None:
        time_ns, _, event = heapq.heappop(self._events)
        event(time_ns)

    def _wait_until(self, time_ns: int) -> None:
        self.clock.sleep_s((time_ns - self.clock.now_ns()) / NS_PER_S)


@dataclass(slots=True)
class Wire:
    """A cable from an output line to trigger inputs: an edge arrives `delay_ns` later.

    The edge carries the number of the trigger that raised it. A real one does not; there the
    driver counts.
    """

    world: World
    delay_ns: int
    inputs: list[Callable[[int, int], None]] = field(default_factory=list)
    falling_inputs: list[Callable[[int, int], None]] = field(default_factory=list)

    def rise(self, time_ns: int, sequence: int) -> None:
        """Send a rising edge to every input, which is called with its time and number."""
        self._send(self.inputs, time_ns, sequence)

    def fall(self, time_ns: int, sequence: int) -> None:
        """Send a falling edge to every input that listens to one."""
        self._send(self.falling_inputs, time_ns, sequence)

    def _send(self, inputs: list[Callable[[int, int], None]], time_ns: int, sequence: int) -> None:
        for receive in inputs:
            self.world.at(time_ns + self.delay_ns, partial(_arrive, receive, sequence))


def _arrive(receive: Callable[[int, int], None], sequence: int, time_ns: int) -> None:
    receive(time_ns, sequence)


@dataclass(slots=True)
class Link:
    """The cable to the computer, shared by the cameras: one picture after the other."""

    world: World
    bytes_per_s: float
    free_ns: int = 0

    def send(self, size_bytes: int, ready_ns: int, arrived: Event) -> None:
        """Carry `size_bytes` that are ready at `ready_ns`; call `arrived` when they are over."""
        start_ns = max(ready_ns, self.free_ns)
        self.free_ns = start_ns + s_to_ns(size_bytes / self.bytes_per_s)
        self.world.at(self.free_ns, arrived)
