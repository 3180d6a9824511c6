"""Digits that a person reads from two metres, and keys pressed while pictures go by."""

from __future__ import annotations

import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_FONT = {
    "0": ("███", "█ █", "█ █", "█ █", "███"),
    "1": (" ██", "  █", "  █", "  █", "  █"),
    "2": ("███", "  █", "███", "█  ", "███"),
    "3": ("███", "  █", "███", "  █", "███"),
    "4": ("█ █", "█ █", "███", "  █", "  █"),
    "5": ("███", "█  ", "███", "  █", "███"),
    "6": ("███", "█  ", "███", "█ █", "███"),
    "7": ("███", "  █", "  █", "  █", "  █"),
    "8": ("███", "█ █", "███", "█ █", "███"),
    "9": ("███", "█ █", "███", "  █", "███"),
    "+": ("   ", " █ ", "███", " █ ", "   "),
    "-": ("   ", "   ", "███", "   ", "   "),
    ".": (" ", " ", " ", " ", "█"),
    " ": ("   ", "   ", "   ", "   ", "   "),
}


def big(words: str, columns: int, lines: int) -> str:
    """Return digits, signs and points as large as `columns` x `lines` of a terminal allow."""
    rows = ["  ".join(_FONT[letter][row] for letter in words) for row in range(5)]
    wide = max(1, min(columns // max(len(rows[0]), 1), 2 * (lines // 5)))
    tall = max(1, min(lines // 5, (wide + 1) // 2))
    stretched = ("".join(letter * wide for letter in row) for row in rows)
    return "\n".join("\n".join([row] * tall) for row in stretched)


@contextmanager
def keyboard() -> Iterator[Callable[[], str]]:
    """Give a function that returns the keys pressed since its last call; none without a terminal.

    The terminal is as it was afterwards; Ctrl-C keeps its meaning.
    """
    if not sys.stdin.isatty():
        yield lambda: ""
        return
    before = termios.tcgetattr(sys.stdin)

    def pressed() -> str:
        keys = ""
        while select.select([sys.stdin], [], [], 0)[0]:
            keys += sys.stdin.read(1)
        return keys

    try:
        tty.setcbreak(sys.stdin)
        yield pressed
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
