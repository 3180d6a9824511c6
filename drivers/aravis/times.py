"""Which trigger a picture belongs to, by the time at which its exposure began."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from rig.core.protocols import Clock

REFIT_NS = 2_000_000_000
"""How long a fit of a camera's clock is left alone."""

DRIFT_PPM = 50
"""How far two clocks may part: quartz in a warm housing against quartz in a computer."""

GOOD_ERROR_NS = 50_000
"""A look at a clock that is this exact is good enough; until one is, there are more looks."""

MAX_CLOCK_ERROR_NS = 1_000_000
"""How far a picture may seem to begin before its trigger, unless the clocks' fit is worse."""


@dataclass(frozen=True, slots=True)
class Fired:
    """One trigger: it was fired between two moments of the computer's clock."""

    sequence: int
    before_ns: int
    after_ns: int


@dataclass(slots=True)
class TriggerLog:
    """The last triggers of a pair, counted from 0 over all segments of a run.

    Where exposures follow triggers, `by_trigger`, a picture may seem to begin before its own: the
    next one is fired much later. Cameras at their own pace allow no such slack.
    """

    by_trigger: bool = True
    count: int = 0
    _fired: deque[Fired] = field(default_factory=lambda: deque(maxlen=256))

    def fired(self, before_ns: int, after_ns: int) -> None:
        """Note a trigger."""
        self._fired.append(Fired(self.count, before_ns, after_ns))
        self.count += 1

    def passed(self) -> None:
        """Count a trigger that could not be fired."""
        self.count += 1

    def sequence_of(self, start_ns: int, error_ns: int = 0) -> int | None:
        """Return the last trigger before an exposure began; None when it began before all.

        `error_ns` is how far the start may be off.
        """
        slack_ns = max(MAX_CLOCK_ERROR_NS, error_ns) if self.by_trigger else 0
        for trigger in reversed(self._fired):
            if trigger.before_ns - slack_ns <= start_ns:
                return trigger.sequence
        return None


@dataclass(slots=True)
class ClockFit:
    """Turns a camera's time into the computer's: one is latched between two looks at the other.

    `latch` makes the camera note its time and returns it in nanoseconds.
    """

    clock: Clock
    latch: Callable[[], tuple[int, int, int]]
    offset_ns: int = 0
    error_ns: int = 0
    fitted_ns: int | None = None

    def to_host_ns(self, device_ns: int) -> int:
        """Return the computer's time of a moment of the camera's."""
        return device_ns + self.offset_ns

    def refit(self, tries: int) -> None:
        """Look at most `tries` times and take the most exact look, unless the fit is better.

        A busy computer looks slowly: then the old fit stays, and its error grows with the drift.
        """
        for _ in range(tries):
            before_ns, device_ns, after_ns = self.latch()
            error_ns = (after_ns - before_ns + 1) // 2
            if self.fitted_ns is None or error_ns < self._grown_error_ns(after_ns):
                self.offset_ns = (before_ns + after_ns) // 2 - device_ns
                self.error_ns, self.fitted_ns = error_ns, after_ns
            if error_ns <= GOOD_ERROR_NS:
                return

    def keep_fresh(self) -> None:
        """Measure again when the last fit is old."""
        if self.fitted_ns is None or self.clock.now_ns() - self.fitted_ns > REFIT_NS:
            self.refit(tries=2)

    def _grown_error_ns(self, now_ns: int) -> int:
        assert self.fitted_ns is not None
        return self.error_ns + (now_ns - self.fitted_ns) * DRIFT_PPM // 1_000_000
