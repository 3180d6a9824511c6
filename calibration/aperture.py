"""Two lenses that let the same light through: what both pictures say, and when it is enough.

Thesis 5.1.1: both cameras look at a well-lit blank surface with the same exposure, gain and rate;
the second aperture is turned until the mean intensities agree, then both are locked.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import CalibrationError
from rig.core.types import Frame, Pair, Settings

TOLERANCE_STOPS = 0.02
LINEARITY_STOPS = 0.05

MOST_SATURATED = 0.001
MOST_UNEVEN = 0.1
FEWEST_DN = 20.0

_SATURATED_DN = 254
_BLOCKS = 4
_HISTORY = 120


@dataclass(frozen=True, slots=True)
class Look:
    """One picture of the surface: `uneven` is (brightest - darkest block) / mean of 4 x 4."""

    mean_dn: float
    saturated: float
    uneven: float


def look(frame: Frame) -> Look:
    """Return what a picture says, uint8 mosaic, all pixels alike."""
    image = frame.image
    high, wide = (side // (2 * _BLOCKS) * 2 for side in image.shape)
    parts = image[: high * _BLOCKS, : wide * _BLOCKS].reshape(_BLOCKS, high, _BLOCKS, wide)
    blocks = parts.mean((1, 3), dtype=np.float64)
    mean = float(image.mean(dtype=np.float64))
    spread = float(np.ptp(blocks)) / max(mean, 1.0)
    return Look(mean, float((image >= _SATURATED_DN).mean()), spread)


@dataclass(frozen=True, slots=True)
class Reading:
    """Both pictures together: the secondary's light over the primary's, in stops."""

    ratio_stops: float
    looks: Pair[Look]

    @property
    def warnings(self) -> list[str]:
        """Return what speaks against the reading, and what to do."""
        told = []
        if max(each.saturated for each in self.looks) > MOST_SATURATED:
            told.append("saturated: take light away")
        if min(each.mean_dn for each in self.looks) < FEWEST_DN:
            told.append("too dark: add light")
        if max(each.uneven for each in self.looks) > MOST_UNEVEN:
            told.append("uneven surface: light it from both sides, or come closer")
        return told


def ratio_stops(means_dn: Pair[float], black_dn: Pair[float]) -> float:
    """Return log2 of the secondary's signal over the primary's, black levels taken off."""
    primary, secondary = (max(m - b, 0.25) for m, b in zip(means_dn, black_dn, strict=True))
    return math.log2(secondary / primary)


def direction(stops: float, tolerance_stops: float) -> str:
    """Return which way to turn the ring of the secondary camera."""
    if abs(stops) <= tolerance_stops:
        return "HOLD"
    return "CLOSE the secondary" if stops > 0 else "OPEN the secondary"


@dataclass(slots=True)
class Lock:
    """Says when the ratio has been within the tolerance for long enough without a break."""

    tolerance_stops: float
    hold_s: float
    readings: list[float] = field(default_factory=list)
    _since_ns: int | None = None

    def see(self, stops: float, time_ns: int) -> bool:
        """Take one ratio of the moment `time_ns`; return whether it is locked."""
        if abs(stops) > self.tolerance_stops:
            self._since_ns = None
            self.readings.clear()
            return False
        if self._since_ns is None:
            self._since_ns = time_ns
        self.readings.append(stops)
        return time_ns - self._since_ns >= self.hold_s * 1e9

    def release(self) -> None:
        """Begin to wait anew."""
        self._since_ns = None
        self.readings.clear()


@dataclass(slots=True)
class Meter:
    """Finds one setting for both cameras at which the brighter one is bright, not saturated.

    Two exposures, one double the other, tell each camera's black level, for a linear response.
    """

    settings: Settings
    longest_us: float
    shortest_us: float
    black_dn: Pair[float] | None = None
    _seen: list[tuple[float, Pair[float]]] = field(default_factory=list)
    _tries: int = 0

    def see(self, looks: Pair[Look]) -> None:
        """Take the looks at pictures taken with `settings`, and choose the next."""
        self._tries += 1
        if self._tries > _METER_TRIES:
            raise CalibrationError(_dark_or_bright(looks))
        means = Pair(*(each.mean_dn for each in looks))
        if max(each.saturated for each in looks) > MOST_SATURATED:
            self._expose(0.3)
            return
        if self._seen:
            self.black_dn = self._black(means)
            self.settings = Settings(self._seen[0][0], self.settings.gain_db)
            return
        wanted = _BRIGHT_DN / max(max(means), 1.0)
        if 0.85 < wanted < 1.2 or self._at_the_end(wanted):
            self._seen.append((self.settings.exposure_us, means))
            self._expose(0.5)
        else:
            self._expose(min(wanted, 8.0))

    def follow(self, looks: Pair[Look]) -> None:
        """Keep the pictures bright while somebody turns the ring; the ratio does not mind."""
        brightest = max(each.mean_dn for each in looks)
        if not 0.5 * _BRIGHT_DN < brightest < 1.4 * _BRIGHT_DN:
            self._expose(min(max(_BRIGHT_DN / max(brightest, 1.0), 0.3), 4.0))

    def _black(self, means: Pair[float]) -> Pair[float]:
        exposure_us, before = self._seen[0]
        share = self.settings.exposure_us / exposure_us
        return Pair(*((m - share * b) / (1 - share) for m, b in zip(means, before, strict=True)))

    def _at_the_end(self, wanted: float) -> bool:
        return wanted > 1 and self.settings.exposure_us >= self.longest_us

    def _expose(self, factor: float) -> None:
        asked = round(self.settings.exposure_us * factor)
        inside = min(max(asked, self.shortest_us), self.longest_us)
        self.settings = Settings(float(inside), self.settings.gain_db)


_BRIGHT_DN = 130.0
_METER_TRIES = 20


def _dark_or_bright(looks: Pair[Look]) -> str:
    bright = max(each.saturated for each in looks) > MOST_SATURATED
    return (
        "the surface is too bright even at the shortest exposure: take light away"
        if bright
        else "the pictures do not settle: is the light steady, and is the surface blank?"
    )


@dataclass(frozen=True, slots=True)
class Linearity:
    """Three exposures: how far each camera is from a straight line, and the ratio at each."""

    exposures_us: tuple[float, float, float]
    worst_stops: float
    ratios_stops: tuple[float, float, float]


def linearity(exposures_us: list[float], means_dn: list[Pair[float]]) -> Linearity:
    """Return how well signals follow three exposures, each camera with a black level of its own."""
    times = np.array(exposures_us)
    signals, worst = [], 0.0
    for side in range(2):
        values = np.array([means[side] for means in means_dn])
        slope, black = np.polyfit(times, values, 1)
        line = slope * times
        off = np.abs(np.log2(np.maximum(values - black, 0.1) / np.maximum(line, 0.1)))
        worst = max(worst, float(off.max()))
        signals.append(values - black)
    ratios = np.log2(np.maximum(signals[1], 0.1) / np.maximum(signals[0], 0.1))
    a, b, c = (float(t) for t in times)
    first, second, third = (float(r) for r in ratios)
    return Linearity((a, b, c), worst, (first, second, third))


@dataclass(slots=True)
class Turner:
    """Turns a ring whose scale nobody knows: a secant on the ratios that the pictures show."""

    tolerance_stops: float
    _degrees_per_stop: float = 30.0
    _last: tuple[float, float] | None = None
    _in_vain: int = 0

    def next_degrees(self, stops: float) -> float:
        """Return how far to turn now, + opens; raises CalibrationError for a ring that is stuck."""
        if self._last is not None:
            self._learn(stops, *self._last)
        if abs(stops) <= _AIM * self.tolerance_stops:
            self._last = None
            return 0.0
        degrees = min(max(-stops * self._degrees_per_stop, -_LARGEST_TURN), _LARGEST_TURN)
        self._last = (stops, degrees)
        return degrees

    def _learn(self, stops: float, before: float, degrees: float) -> None:
        moved = stops - before
        self._in_vain = self._in_vain + 1 if abs(moved) < 0.002 else 0
        if self._in_vain >= _MOST_IN_VAIN:
            raise CalibrationError(
                f"the ring does not change the pictures any more at {stops:+.2f} stops: it is at "
                "the end of its travel, locked, or not the secondary's; set the primary's first"
            )
        if moved * degrees > 0 and abs(moved) > 0.02:
            self._degrees_per_stop = min(max(degrees / moved, 5.0), 200.0)


_AIM = 0.5
_LARGEST_TURN = 20.0
_MOST_IN_VAIN = 6


@dataclass(slots=True)
class History:
    """The last ratios, for the line that shows whether the ring is turned the right way."""

    stops: deque[float] = field(default_factory=lambda: deque(maxlen=_HISTORY))

    def spark(self, width: int) -> str:
        """Return the last `width` sizes of the ratio as one line of blocks."""
        shown = [abs(value) for value in list(self.stops)[-width:]]
        reach = max([*shown, 0.05])
        return "".join("▁▂▃▄▅▆▇█"[min(int(8 * v / reach), 7)] for v in shown)


def histogram(frame: Frame) -> NDArray[np.float64]:
    """Return the share of pixels at each of the 256 grey values."""
    counts = np.bincount(frame.image.ravel(), minlength=256)
    return np.asarray(counts / frame.image.size, np.float64)
