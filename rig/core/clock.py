"""Two kinds of time: the computer's, and one that moves only when told."""

from __future__ import annotations

import time
from dataclasses import dataclass

from rig.core.units import s_to_ns


@dataclass(frozen=True, slots=True)
class SystemClock:
    """The computer's monotonic clock."""

    def now_ns(self) -> int:
        """Return the monotonic time in nanoseconds."""
        return time.monotonic_ns()

    def sleep_s(self, duration_s: float) -> None:
        """Sleep; nothing happens for a duration <= 0."""
        if duration_s > 0:
            time.sleep(duration_s)


@dataclass(slots=True)
class VirtualClock:
    """Time that moves only when told, so that a simulated drive costs no waiting.

    >>> clock = VirtualClock()
    >>> clock.sleep_s(0.5)
    >>> clock.now_ns()
    500000000
    """

    time_ns: int = 0

    def now_ns(self) -> int:
        """Return the simulated time in nanoseconds."""
        return self.time_ns

    def sleep_s(self, duration_s: float) -> None:
        """Advance the time; nothing happens for a duration <= 0."""
        if duration_s > 0:
            self.time_ns += s_to_ns(duration_s)

    def advance_to_ns(self, time_ns: int) -> None:
        """Move forward to `time_ns`; time never runs back."""
        self.time_ns = max(self.time_ns, time_ns)
