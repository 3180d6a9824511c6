"""Words and numbers that a person reads from two metres, drawn with blocks."""

from __future__ import annotations

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
    " ": ("  ", "  ", "  ", "  ", "  "),
    "A": ("███", "█ █", "███", "█ █", "█ █"),
    "C": ("███", "█  ", "█  ", "█  ", "███"),
    "D": ("██ ", "█ █", "█ █", "█ █", "██ "),
    "E": ("███", "█  ", "██ ", "█  ", "███"),
    "H": ("█ █", "█ █", "███", "█ █", "█ █"),
    "I": ("█", "█", "█", "█", "█"),
    "K": ("█ █", "█ █", "██ ", "█ █", "█ █"),
    "L": ("█  ", "█  ", "█  ", "█  ", "███"),
    "N": ("█  █", "██ █", "█ ██", "█  █", "█  █"),
    "O": ("███", "█ █", "█ █", "█ █", "███"),
    "P": ("███", "█ █", "███", "█  ", "█  "),
    "S": ("███", "█  ", "███", "  █", "███"),
    "T": ("███", " █ ", " █ ", " █ ", " █ "),
    "W": ("█   █", "█   █", "█ █ █", "██ ██", "█   █"),
}
ROWS = 5


def big(words: str, columns: int, lines: int) -> list[str]:
    """Return the rows of digits, signs and capitals, as large as `columns` x `lines` allow.

    Twice as wide as tall, because a terminal's cell is twice as tall as wide.
    """
    rows = [" ".join(_FONT[letter][row] for letter in words) for row in range(ROWS)]
    tall = max(1, min(lines // ROWS, columns // (2 * len(rows[0]))))
    wide = max(1, min(2 * tall, columns // len(rows[0])))
    return [stretched for row in rows for stretched in ["".join(c * wide for c in row)] * tall]
