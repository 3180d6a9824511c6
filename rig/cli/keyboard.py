"""Keys pressed while pictures go by."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_MOST_BYTES = 64


@contextmanager
def keyboard() -> Iterator[Callable[[], str]]:
    """Give a function that returns the keys pressed since its last call; none without a terminal.

    The terminal is as it was afterwards; Ctrl-C keeps its meaning.
    """
    if not sys.stdin.isatty():
        yield lambda: ""
        return
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)

    def pressed() -> str:
        waiting = select.select([terminal], [], [], 0)[0]
        return os.read(terminal, _MOST_BYTES).decode("ascii", "ignore") if waiting else ""

    try:
        tty.setcbreak(terminal)
        yield pressed
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
