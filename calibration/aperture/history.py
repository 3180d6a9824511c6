"""The last ratios, for the line that shows whether the ring is turned the right way."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

_KEPT = 240
_BLOCKS = "▁▂▃▄▅▆▇█"
_SMALLEST_REACH_STOPS = 0.05


@dataclass(slots=True)
class History:
    """Keeps the last ratios, in stops."""

    stops: deque[float] = field(default_factory=lambda: deque(maxlen=_KEPT))

    def line(self, width: int) -> str:
        """Return the last `width` distances from zero as one line of blocks; low is good."""
        shown = [abs(value) for value in list(self.stops)[-width:]]
        reach = max([*shown, _SMALLEST_REACH_STOPS])
        return "".join(_BLOCKS[min(int(8 * value / reach), 7)] for value in shown)
