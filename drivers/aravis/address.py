"""`aravis:SERIAL,SERIAL?OPTION=VALUE&...`: two real cameras, the primary first.

Serial numbers are decimal or hexadecimal, or network addresses. Options: `mode` (next-frame,
free-run, software), `rate_hz` (a number, or max), `packet_bytes` (GigE with jumbo frames),
`link_bytes_per_s` (each camera's share of the cable).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from rig.core.errors import UsageError
from rig.core.protocols import Source
from rig.core.types import Pair
from rig.drivers.aravis.session import MODES, Mode, PairSpec
from rig.drivers.aravis.source import Surroundings, open_pair
from rig.drivers.blackfly import Setup

SCHEME = "aravis"

_OPTIONS = ("link_bytes_per_s", "mode", "packet_bytes", "rate_hz")
_EXAMPLE = "aravis:18284899,18284900"


def open_aravis(name: str, options: Mapping[str, str]) -> Source:
    """Open two real cameras; raises UsageError for words that cannot be meant, else CameraError."""
    spec = read_spec(name, options)
    query = "&".join(f"{key}={options[key]}" for key in sorted(options))
    address = f"{SCHEME}:{name}" + (f"?{query}" if query else "")
    return open_pair(spec, Surroundings(address))


def read_spec(name: str, options: Mapping[str, str]) -> PairSpec:
    """Return what an address asks for; raises UsageError."""
    for option in options:
        if option not in _OPTIONS:
            raise UsageError(f"aravis: unknown option {option!r}; known: {', '.join(_OPTIONS)}")
    serials = [serial.strip() for serial in name.split(",")]
    if len(serials) != 2 or not all(serials) or serials[0] == serials[1]:
        raise UsageError(
            f"aravis:{name}: name two different cameras, the primary first, as in {_EXAMPLE}"
        )
    mode = read_mode(SCHEME, options.get("mode", "next-frame"))
    rate_hz = _rate(options.get("rate_hz", "10"))
    if mode == "free-run" and rate_hz is None:
        raise UsageError("aravis: mode=free-run needs a rate_hz that is a number, got 'max'")
    return PairSpec(
        Pair(*serials),
        mode=mode,
        rate_hz=rate_hz,
        packet_bytes=_whole(options, "packet_bytes", None),
        setup=Setup(link_bytes_per_s=_whole(options, "link_bytes_per_s", 190_000_000) or 0),
    )


def read_mode(scheme: str, word: str) -> Mode:
    """Return how frames are started; raises UsageError."""
    if word not in MODES:
        raise UsageError(f"{scheme}: mode must be {', '.join(MODES)}, got {word!r}")
    return word


def _rate(word: str) -> float | None:
    if word == "max":
        return None
    try:
        rate_hz = float(word)
    except ValueError:
        rate_hz = math.nan
    if not (math.isfinite(rate_hz) and rate_hz > 0):
        raise UsageError(f"aravis: rate_hz must be a number above 0, or max, got {word!r}")
    return rate_hz


def _whole(options: Mapping[str, str], name: str, absent: int | None) -> int | None:
    word = options.get(name)
    if word is None:
        return absent
    if not word.isdecimal() or int(word) == 0:
        raise UsageError(f"aravis: {name} must be a whole number above 0, got {word!r}")
    return int(word)
