"""Ctrl-C: the first press stops at a safe point, the second one at once."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType


@dataclass(slots=True)
class StopRequest:
    """Whether somebody asked the run to end."""

    requested: bool = False


@contextmanager
def stop_on_signal(ending: str = "finishing the recording") -> Iterator[StopRequest]:
    """Turn the first SIGINT or SIGTERM into a request; a second one raises KeyboardInterrupt.

    `ending` says what the first one begins.
    """
    stop = StopRequest()

    def on_signal(number: int, _: FrameType | None) -> None:
        if stop.requested:
            raise KeyboardInterrupt
        stop.requested = True
        name = signal.Signals(number).name
        print(f"{name}: {ending}; again to stop at once", file=sys.stderr)

    before = {
        number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
