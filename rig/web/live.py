"""The live page as a whole: a slot that the loop fills, a painter thread, and the server."""

from __future__ import annotations

import os
import sys
import threading
import time
from dataclasses import dataclass
from typing import Any, Self

from rig.core.types import Pair
from rig.web.page import Page
from rig.web.server import LiveServer, Press
from rig.web.slot import Glimpse, Slot

FASTEST_HZ = 10.0
_BACKGROUND_NICENESS = 10
_WAIT_S = 0.2
_SWITCH_S = 0.0005
_REST = 3.0
"""Rest per time of work: on a slow or busy computer the page becomes slower, not the loop."""


@dataclass(slots=True, eq=False)
class LiveView:
    """Shows the newest glimpse at most ten times a second, on threads that give way to the loop.

    A context manager; `url` is where the page is, token included.
    """

    slot: Slot
    page: Page
    server: LiveServer
    _ending: threading.Event
    _threads: list[threading.Thread]
    _interval_s: float = 0.005

    @classmethod
    def open(
        cls, host: str, port: int, token: str, press: Press | None = None, banner: str = ""
    ) -> LiveView:
        """Bind the address; raises RigError when that cannot be."""
        page = Page(banner)
        server = LiveServer(host, port, token, page, press)
        return cls(Slot(), page, server, threading.Event(), [])

    @property
    def url(self) -> str:
        """Return the address to open in a browser."""
        return self.server.guard.url

    def __enter__(self) -> Self:
        """Start to serve and to paint; the loop gets the interpreter back within 0.5 ms."""
        self._interval_s = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_S)
        for name, work in (("rig-web", self._serve), ("rig-painter", self._paint)):
            thread = threading.Thread(target=work, name=name, daemon=True)
            thread.start()
            self._threads.append(thread)
        return self

    def __exit__(self, *exc: object) -> None:
        """Show the last glimpse as the end, and stop."""
        self._ending.set()
        self._threads[1].join()
        self.server.shutdown()
        self.server.server_close()
        sys.setswitchinterval(self._interval_s)

    def _serve(self) -> None:
        _give_way()
        self.server.serve_forever(poll_interval=0.1)

    def _paint(self) -> None:
        _give_way()
        last: Glimpse | None = None
        while not self._ending.is_set():
            glimpse = self.slot.take(_WAIT_S)
            begun_s = time.monotonic()
            if glimpse is not None:
                last = glimpse
                self.page.show(glimpse.describe(), glimpse.frames)
            spent_s = time.monotonic() - begun_s
            self._ending.wait(max(1 / FASTEST_HZ - spent_s, _REST * spent_s))
        glimpse = self.slot.take(0.0) or last
        ended: dict[str, Any] = {"ended": True}
        if glimpse is None:
            self.page.show(ended, Pair(None, None))
        else:
            self.page.show(glimpse.describe() | ended, glimpse.frames)


def _give_way() -> None:
    """Let every other thread go first; on Linux niceness is per thread."""
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _BACKGROUND_NICENESS)
