"""Where the loop leaves what it saw last: one place, and whoever is late finds the newest."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from rig.core.types import Frame, Pair

Describe = Callable[[], dict[str, Any]]
"""Makes the words and numbers that go with the pictures; called on the page's own thread."""


@dataclass(frozen=True, slots=True, eq=False)
class Glimpse:
    """What the loop saw: `frames` None where none came, and what to say about them."""

    frames: Pair[Frame | None]
    describe: Describe


@dataclass(slots=True, eq=False)
class Slot:
    """Holds the newest glimpse. `put` takes well under a microsecond's work and never waits."""

    _newest: Glimpse | None = None
    _filled: threading.Event = field(default_factory=threading.Event)

    def put(self, glimpse: Glimpse) -> None:
        """Leave a glimpse; one that nobody took is forgotten."""
        self._newest = glimpse
        if not self._filled.is_set():
            self._filled.set()

    def take(self, timeout_s: float) -> Glimpse | None:
        """Wait for a glimpse that was not taken yet; None when there is none in time."""
        if not self._filled.wait(timeout_s):
            return None
        self._filled.clear()
        return self._newest
