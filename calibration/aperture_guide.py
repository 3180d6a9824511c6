"""The five minutes of an aperture calibration, one pair of pictures after the other."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rig.calibration.aperture import (
    LINEARITY_STOPS,
    History,
    Linearity,
    Lock,
    Look,
    Meter,
    Reading,
    direction,
    histogram,
    linearity,
    look,
    ratio_stops,
)
from rig.calibration.plots import histogram_plot
from rig.core.types import Frame, Limits, Pair, Settings

_SHARES = (0.35, 0.7, 1.0)
_FRAMES_EACH = 4
_LONGEST_US = 30_000.0


@dataclass(frozen=True, slots=True)
class ApertureResult:
    """How alike both cameras see; `uncertainty_stops` is one standard deviation."""

    ratio_stops: float
    uncertainty_stops: float
    tolerance_stops: float
    means_dn: Pair[float]
    settings: Settings
    linear: Linearity
    uneven: Pair[float]
    readings: int
    plot: str

    @property
    def passed(self) -> bool:
        """Return whether both cameras agree and are linear."""
        alike = abs(self.ratio_stops) <= self.tolerance_stops
        return alike and self.linear.worst_stops <= LINEARITY_STOPS


@dataclass(slots=True, eq=False)
class ApertureGuide:
    """Meters, watches the ratio until it holds, then checks three exposures.

    Give every complete pair to `see` and take the next pair with `settings`, both cameras alike.
    """

    limits: Limits
    tolerance_stops: float
    hold_s: float
    reading: Reading | None = None
    result: ApertureResult | None = None
    history: History = field(default_factory=History)
    _meter: Meter = field(init=False)
    _lock: Lock = field(init=False)
    _held: list[float] = field(default_factory=list)
    _steps: list[tuple[float, Pair[float]]] = field(default_factory=list)

    def __post_init__(self) -> None:
        shortest_us, longest_us = self.limits.exposure_us
        gain_db = self.limits.gain_db[0]
        start = Settings(min(max(1_000.0, shortest_us), longest_us), gain_db)
        self._meter = Meter(start, min(longest_us, _LONGEST_US), shortest_us)
        self._lock = Lock(self.tolerance_stops, self.hold_s)

    @property
    def settings(self) -> Settings:
        """Return what both cameras use for the next pair."""
        if self.locked and len(self._steps) < len(_SHARES) * _FRAMES_EACH:
            share = _SHARES[len(self._steps) // _FRAMES_EACH]
            base = self._meter.settings
            return Settings(float(round(share * base.exposure_us)), base.gain_db)
        return self._meter.settings

    @property
    def locked(self) -> bool:
        """Return whether the ratio has held for long enough."""
        return bool(self._held)

    @property
    def turning(self) -> bool:
        """Return whether somebody should look at the ratio and turn the ring."""
        return self.reading is not None and not self.locked

    @property
    def hint(self) -> str:
        """Return what to do, in a few words."""
        if self.locked:
            return "LOCKED: keep still"
        if self.reading is None:
            return "metering"
        return direction(self.reading.ratio_stops, self.tolerance_stops)

    def see(self, frames: Pair[Frame]) -> None:
        """Take one pair; raises CalibrationError when the surface cannot be measured."""
        looks = Pair(*(look(frame) for frame in frames))
        black_dn = self._meter.black_dn
        if black_dn is None:
            self._meter.see(looks)
        elif self.locked:
            self._check_linearity(frames, looks)
        else:
            self._watch(frames, looks, black_dn)

    def _watch(self, frames: Pair[Frame], looks: Pair[Look], black_dn: Pair[float]) -> None:
        ratio = ratio_stops(_means(looks), black_dn)
        self.reading = Reading(ratio, looks)
        self.history.stops.append(ratio)
        if self.reading.warnings:
            self._lock.release()
        elif self._lock.see(ratio, frames.primary.device_time_ns):
            self._held = list(self._lock.readings)
            return
        self._meter.follow(looks)

    def _check_linearity(self, frames: Pair[Frame], looks: Pair[Look]) -> None:
        self._steps.append((frames.primary.used.exposure_us, _means(looks)))
        if len(self._steps) < len(_SHARES) * _FRAMES_EACH:
            return
        exposures, means = [], []
        for first in range(0, len(self._steps), _FRAMES_EACH):
            group = self._steps[first : first + _FRAMES_EACH]
            exposures.append(group[0][0])
            means.append(Pair(*(float(np.mean([m[side] for _, m in group])) for side in (0, 1))))
        linear = linearity(exposures, means)
        held = np.array(self._held)
        drift = float(np.ptp(linear.ratios_stops)) / np.sqrt(12)
        noise = float(held.std(ddof=1)) / np.sqrt(len(held)) if len(held) > 1 else 0.0
        self.result = ApertureResult(
            ratio_stops=float(held.mean()),
            uncertainty_stops=float(np.hypot(noise, drift)),
            tolerance_stops=self.tolerance_stops,
            means_dn=_means(looks),
            settings=self._meter.settings,
            linear=linear,
            uneven=Pair(*(each.uneven for each in looks)),
            readings=len(held),
            plot=histogram_plot(Pair(*map(histogram, frames)), "Grey values of both cameras"),
        )


def _means(looks: Pair[Look]) -> Pair[float]:
    return Pair(*(each.mean_dn for each in looks))
