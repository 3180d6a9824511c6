"""The options of a `sim:` address, and what reads each of them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any


def _whole(word: str) -> int:
    if not word.isdecimal():
        raise ValueError("a whole number, 0 or more")
    return int(word)


def _duration(word: str) -> float:
    if not (number := _finite(word)) >= 0:
        raise ValueError("a number, 0 or more")
    return number


def _speed(word: str) -> float:
    if not (number := _finite(word)) > 0:
        raise ValueError("a number above 0")
    return number


def _rate(word: str) -> float | None:
    if word == "max":
        return None
    if not (number := _finite(word)) > 0:
        raise ValueError("a number above 0, or max")
    return number


def _finite(word: str) -> float:
    """Return a number; NaN, which no range contains, for a word that is not one."""
    try:
        number = float(word)
    except ValueError:
        return math.nan
    return number if math.isfinite(number) else math.nan


def _size(word: str) -> tuple[int, int]:
    found = re.fullmatch(r"([1-9]\d*)x([1-9]\d*)", word)
    if not found:
        raise ValueError("WIDTHxHEIGHT in pixels, such as 640x480")
    return int(found[1]), int(found[2])


def _split(word: str) -> str:
    if word not in ("train", "test"):
        raise ValueError("train or test")
    return word


def _camera(word: str) -> str:
    """Return a shipped model's name as it is, and a file's path from the root."""
    return str(Path(word).resolve()) if word.endswith(".toml") else word


def on(word: str) -> bool:
    """Return whether a word is `on`; raises ValueError for one that is neither on nor off."""
    if word not in ("on", "off"):
        raise ValueError("on or off")
    return word == "on"


def _share(word: str) -> float:
    if not 0 <= (number := _finite(word)) <= 1:
        raise ValueError("a number from 0 to 1")
    return number


def _cosine_power(word: str) -> float:
    if not 0 <= (number := _finite(word)) <= 4:
        raise ValueError("a number from 0 to 4, where 1 is the cos^4 law")
    return number


def _distortion(word: str) -> tuple[float, ...]:
    numbers = [_finite(part) for part in word.split(",")]
    if len(numbers) > 5 or not all(abs(number) <= 1 for number in numbers):
        raise ValueError("up to five numbers k1,k2,p1,p2,k3 of at most 1")
    return tuple(numbers + [0.0] * (5 - len(numbers)))


def _f_numbers(word: str) -> tuple[float, float]:
    numbers = [_finite(part) for part in word.split(",")]
    if len(numbers) > 2 or not all(0.7 <= number <= 64 for number in numbers):
        raise ValueError("an f-number from 0.7 to 64, or two, PRIMARY,SECONDARY")
    return numbers[0], numbers[-1]


SIMULATION_OPTIONS: Mapping[str, Callable[[str], Any]] = {
    "camera": _camera,
    "decision_ms": _duration,
    "latency_frames": _whole,
    "rate_hz": _rate,
    "seed": _whole,
    "size": _size,
    "speed_mps": _speed,
    "split": _split,
}
"""What an option of `sim:` is read with; it raises ValueError with what the option must be."""

DEPTH = "depth"
"""`depth=on` puts the depth of the primary's view into the recording; absent, it stays out."""


OPTICS_OPTIONS: Mapping[str, Callable[[str], Any]] = {
    "distortion": _distortion,
    "f_number": _f_numbers,
    "glare": _share,
    "vignetting": _cosine_power,
}
"""What stands before the sensor besides an ideal lens; absent, nothing does."""


LIGHT_STEP = "light_step"
"""`light_step=10@30` multiplies the light by 10 from pair 30 on; absent, the light stays."""

STAND = "stand"
"""`stand=25@0.3` stands still for 25 triggers every 0.3 m, without blur; absent, it drives."""

DEFAULTS = {
    "camera": "blackfly-s-u3-31s4",
    "decision_ms": "0",
    "latency_frames": "0",
    "rate_hz": "10",
    "size": "640x480",
    "speed_mps": "13.9",
}
"""Values of the options of SIMULATION_OPTIONS that the address need not name."""
