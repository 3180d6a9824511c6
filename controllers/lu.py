"""Exposure and gain by a search for the most entropy along one line (Lu et al. 2010).

Both are scaled by the same share of their ranges, so one number is searched: first coarsely, then
around the best at half the step, one frame an evaluation. The best holds until the mean brightness
leaves that of the best frame by more than `threshold_dn` (thesis 3.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from rig.controllers.arrival import Arrival
from rig.core.types import Auto, Command, Diagnostics, Frame, Limits, Settings
from rig.vision.metrics import entropy_bits, mean_dn, sample

INFORMATION_MIN_BITS = 3.0
"""Less entropy than this at the best place is none: it is searched again."""

ENTROPY_SHARE_MIN = 0.75
"""Less than this share of the best entropy, and it is searched again: white hides in the mean."""


class Look(NamedTuple):
    """What one frame showed at a place on the line."""

    place: float
    entropy_bits: float
    mean_dn: float


@dataclass(slots=True)
class LuController:
    """Maximises the entropy over s in 0..1, where s = 0 is shortest and lowest, 1 longest, highest.

    Exposure is geometric in s and gain, being in dB, even. `coarse` is the number of places looked
    at first, `halvings` how often the step is then halved. Raises ValueError for an option out of
    range.
    """

    threshold_dn: float = 80.0
    coarse: int = 5
    halvings: int = 3
    _limits: Limits = field(init=False, default_factory=Limits)
    _command: Settings = field(init=False)
    _queue: list[float] = field(init=False, default_factory=list)
    _seen: list[Look] = field(init=False, default_factory=list)
    _step: float = field(init=False, default=0.0)
    _entropy: float = field(init=False, default=0.0)
    _phase: str = field(init=False, default="search")
    _searches: int = field(init=False, default=0)
    _arrival: Arrival = field(init=False, default_factory=Arrival)

    def __post_init__(self) -> None:
        if not self.threshold_dn > 0:
            raise ValueError(f"threshold_dn must be > 0, got {self.threshold_dn!r}")
        if self.coarse < 3:
            raise ValueError(f"coarse must be >= 3, got {self.coarse!r}")
        if self.halvings < 0:
            raise ValueError(f"halvings must be >= 0, got {self.halvings!r}")
        self._command = Auto().start

    def reset(self, limits: Limits) -> Command:
        """Forget the search and return the first settings: the shortest and lowest."""
        self._limits = limits
        self._searches, self._arrival = 0, Arrival()
        self._begin()
        self._command = self._settings(self._queue.pop(0))
        return self._command

    def step(self, frame: Frame) -> Command:
        """Take the frame as an evaluation, or hold while its mean stays near the best's."""
        part = sample(frame.image, frame.pixel_format)
        self._entropy = entropy_bits(part.judged(part.grey()))
        if not self._arrival.due(frame.used, self._command):
            return self._command
        mean = mean_dn(frame.image)
        if self._phase == "search":
            self._seen.append(Look(self._place(frame.used), self._entropy, mean))
            self._command = self._settings(self._next())
        elif self._is_over(mean):
            self._begin()
            self._command = self._settings(self._queue.pop(0))
        return self._command

    def diagnostics(self) -> Diagnostics:
        """Return the phase (search or hold), the entropy and the length of the search."""
        return {
            "phase": self._phase,
            "entropy_bits": self._entropy,
            "evaluations": float(len(self._seen)),
            "searches": float(self._searches),
        }

    def _is_over(self, mean: float) -> bool:
        """Return whether what was found no longer holds: the light changed, or all was black."""
        best = self._best()
        changed = abs(mean - best.mean_dn) > self.threshold_dn
        lost = self._entropy < ENTROPY_SHARE_MIN * best.entropy_bits
        return changed or lost or best.entropy_bits < INFORMATION_MIN_BITS

    def _best(self) -> Look:
        return max(self._seen, key=lambda look: look.entropy_bits)

    def _begin(self) -> None:
        self._queue = np.linspace(0, 1, self.coarse).tolist()
        self._seen, self._step = [], 1 / (self.coarse - 1)
        self._phase = "search"
        self._searches += 1

    def _next(self) -> float:
        """Return the next place to look at, or the best one when the search is over."""
        best = self._best().place
        least = 0.99 / (self.coarse - 1) / 2**self.halvings
        while not self._queue:
            self._step /= 2
            if self._step < least:
                self._phase = "hold"
                return best
            beside = (best - self._step, best + self._step)
            self._queue = [place for place in beside if 0 <= place <= 1]
        return self._queue.pop(0)

    def _settings(self, place: float) -> Settings:
        (shortest_us, longest_us), (lowest_db, highest_db) = _ranges(self._limits)
        exposure_us = shortest_us * (longest_us / shortest_us) ** place
        gain_db = lowest_db + place * (highest_db - lowest_db)
        return Settings(exposure_us, gain_db).clamp(self._limits)

    def _place(self, used: Settings) -> float:
        """Return the nearest place on the line to settings that may lie beside it."""
        (shortest_us, longest_us), (lowest_db, highest_db) = _ranges(self._limits)
        shares = []
        if longest_us > shortest_us:
            shares.append(math.log(used.exposure_us / shortest_us, longest_us / shortest_us))
        if highest_db > lowest_db:
            shares.append((used.gain_db - lowest_db) / (highest_db - lowest_db))
        return min(max(sum(shares) / max(len(shares), 1), 0.0), 1.0)


def _ranges(limits: Limits) -> tuple[tuple[float, float], tuple[float, float]]:
    return limits.exposure_us, limits.gain_db
