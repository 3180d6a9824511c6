"""Says when two lenses have agreed for long enough."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Lock:
    """Closes when the ratio has been within the tolerance for `hold_s` without a break."""

    tolerance_stops: float
    hold_s: float
    readings: int = 0
    _since_ns: int | None = None

    def see(self, stops: float, time_ns: int) -> bool:
        """Take one ratio of the moment `time_ns`; return whether it is locked."""
        if abs(stops) > self.tolerance_stops:
            self.release()
            return False
        if self._since_ns is None:
            self._since_ns = time_ns
        self.readings += 1
        return time_ns - self._since_ns >= self.hold_s * 1e9

    def release(self) -> None:
        """Begin to wait anew."""
        self._since_ns = None
        self.readings = 0
