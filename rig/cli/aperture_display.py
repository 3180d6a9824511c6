"""An aperture calibration as a person sees it: large on a terminal, as lines, or on a page."""

from __future__ import annotations

import os
import shutil
import sys
from typing import Any

from rig.calibration.aperture.guide import ApertureGuide
from rig.cli.big import ROWS, big
from rig.cli.terminal import Terminal
from rig.core.types import Frame, Pair

KEYS = {"o": 5.0, "c": -5.0, "O": 1.0, "C": -1.0}
"""What the keys turn the simulated ring by, degrees; + opens."""

_LABELS = [
    [key, f"{'open' if degrees > 0 else 'close'} {abs(degrees):.0f}°"]
    for key, degrees in KEYS.items()
]
_SAY_EVERY = 10
_HOME, _REST_OF_LINE, _REST_OF_SCREEN = "\033[H", "\033[K", "\033[J"
_GOOD, _WARN, _PLAIN = "\033[32m", "\033[31m", "\033[0m"
_SMALL_LINES = 5


def show(guide: ApertureGuide, triggers: int, keys: bool, terminal: Terminal) -> None:
    """Draw the state large on a terminal, or say it once a second elsewhere."""
    if terminal.quiet or guide.reading is None:
        return
    if sys.stderr.isatty():
        columns, lines = shutil.get_terminal_size()
        print(screen(guide, keys, columns, lines), end="", file=sys.stderr, flush=True)
    elif triggers % _SAY_EVERY == 0:
        ratio = f"{guide.reading.ratio_stops:+.2f} stops"
        terminal.say(" | ".join([ratio, guide.hint, *guide.reading.warnings]))


def screen(guide: ApertureGuide, keys: bool, columns: int, lines: int) -> str:
    """Return a whole terminal: ratio and direction large, then warnings, history and keys."""
    reading = guide.reading
    assert reading is not None
    half = max((lines - _SMALL_LINES - len(reading.warnings)) // 2, ROWS)
    rows = ["stops, secondary over primary", *big(f"{reading.ratio_stops:+.2f}", columns, half), ""]
    rows += big(guide.hint, columns, half)
    rows += [f"! {warning}" for warning in reading.warnings]
    rows += [guide.history.line(columns - 1)]
    rows += [" ".join(f"{key} {label}" for key, label in _LABELS)] if keys else []
    coloured = [_colour(guide) + row[: columns - 1] + _PLAIN + _REST_OF_LINE for row in rows]
    return _HOME + "\n".join(coloured[: lines - 1]) + _REST_OF_SCREEN


def _colour(guide: ApertureGuide) -> str:
    if os.environ.get("NO_COLOR"):
        return ""
    return _GOOD if is_good(guide) else _WARN


def is_good(guide: ApertureGuide) -> bool:
    """Return whether nothing needs to be done."""
    warned = guide.reading is not None and guide.reading.warnings
    return guide.hint in ("HOLD", "LOCKED") and not warned


def page_state(guide: ApertureGuide, frames: Pair[Frame], keys: bool) -> dict[str, Any]:
    """Return what the page shows."""
    reading = guide.reading
    state: dict[str, Any] = {
        "title": "aperture calibration: turn the ring of the secondary camera",
        "status": guide.hint,
        "hint": guide.hint,
        "values": [
            ["exposure", *(f"{frame.used.exposure_us:.0f} us" for frame in frames)],
            ["gain", *(f"{frame.used.gain_db:.1f} dB" for frame in frames)],
        ],
        "history": list(guide.history.stops),
        "keys": _LABELS if keys else [],
    }
    if reading is not None:
        state["big"] = f"{reading.ratio_stops:+.2f}"
        state["level"] = "good" if is_good(guide) else "warn"
        state["notes"] = ["stops, secondary over primary", *reading.warnings]
        state["values"] += [
            ["mean", *(f"{each.mean_dn:.1f}" for each in reading.looks)],
            ["saturated", *(f"{each.saturated:.2%}" for each in reading.looks)],
            ["unevenness", *(f"{each.uneven:.1%}" for each in reading.looks)],
        ]
    return state
