"""The hand of `--auto`: it turns a ring of which it knows only what the pictures show."""

from __future__ import annotations

from dataclasses import dataclass

from rig.core.errors import CalibrationError

_AIM = 0.5
_LARGEST_TURN_DEG = 20.0
_SCALE_DEG_PER_STOP = (5.0, 200.0)
_STILL_STOPS = 0.002
_CLEAR_STOPS = 0.02
_MOST_IN_VAIN = 6


@dataclass(slots=True)
class Hand:
    """Turns a ring whose scale nobody knows: a secant on the ratios that the pictures show."""

    tolerance_stops: float
    _degrees_per_stop: float = 30.0
    _last: tuple[float, float] | None = None
    _in_vain: int = 0

    def next_degrees(self, stops: float) -> float:
        """Return how far to turn now, + opens; raises CalibrationError for a ring that is stuck."""
        if self._last is not None:
            self._learn(stops, *self._last)
        if abs(stops) <= _AIM * self.tolerance_stops:
            self._last = None
            return 0.0
        degrees = min(max(-stops * self._degrees_per_stop, -_LARGEST_TURN_DEG), _LARGEST_TURN_DEG)
        self._last = (stops, degrees)
        return degrees

    def _learn(self, stops: float, before: float, degrees: float) -> None:
        moved = stops - before
        self._in_vain = self._in_vain + 1 if abs(moved) < _STILL_STOPS else 0
        if self._in_vain >= _MOST_IN_VAIN:
            raise CalibrationError(
                f"the ring does not change the pictures any more at {stops:+.2f} stops: it is at "
                "the end of its travel, locked, or not the secondary's; set the primary's first"
            )
        if moved * degrees > 0 and abs(moved) > _CLEAR_STOPS:
            least, most = _SCALE_DEG_PER_STOP
            self._degrees_per_stop = min(max(degrees / moved, least), most)
