"""The five minutes of an aperture calibration, one pair of pictures after the other."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rig.calibration.aperture.history import History
from rig.calibration.aperture.linearity import LINEARITY_STOPS, Linearity, linearity
from rig.calibration.aperture.lock import Lock
from rig.calibration.aperture.meter import Meter
from rig.calibration.aperture.reading import Reading, direction, ratio_stops
from rig.calibration.aperture.surface import Look, histogram, look
from rig.calibration.plots import histogram_plot
from rig.core.types import Frame, Limits, Pair, Settings

_SHARES = (0.35, 0.7, 1.0)
_FRAMES_EACH = 4
_FRAMES = len(_SHARES) * _FRAMES_EACH
_START_US = 1_000.0


@dataclass(frozen=True, slots=True)
class ApertureResult:
    """How alike both cameras see, as the three exposures of the linearity check tell."""

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
        alike = abs(self.linear.ratio_stops) <= self.tolerance_stops
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
    locked: bool = False
    history: History = field(default_factory=History)
    _meter: Meter = field(init=False)
    _lock: Lock = field(init=False)
    _steps: list[tuple[float, Pair[float]]] = field(default_factory=list)

    def __post_init__(self) -> None:
        start = Settings(_START_US, self.limits.gain_db[0]).clamp(self.limits)
        self._meter = Meter(start, self.limits)
        self._lock = Lock(self.tolerance_stops, self.hold_s)

    @property
    def settings(self) -> Settings:
        """Return what both cameras use for the next pair."""
        base = self._meter.settings
        if not self.locked or len(self._steps) >= _FRAMES:
            return base
        share = _SHARES[len(self._steps) // _FRAMES_EACH]
        return Settings(float(round(share * base.exposure_us)), base.gain_db).clamp(self.limits)

    @property
    def turning(self) -> bool:
        """Return whether somebody should look at the ratio and turn the ring."""
        return self.reading is not None and not self.locked

    @property
    def hint(self) -> str:
        """Return what to do, in one word: WAIT, OPEN, CLOSE, HOLD or LOCKED."""
        if self.locked:
            return "LOCKED"
        if self.reading is None:
            return "WAIT"
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
            self.locked = True
            return
        self._meter.follow(looks)

    def _check_linearity(self, frames: Pair[Frame], looks: Pair[Look]) -> None:
        self._steps.append((frames.primary.used.exposure_us, _means(looks)))
        if len(self._steps) < _FRAMES:
            return
        linear = _judge(self._steps)
        if abs(linear.ratio_stops) > self.tolerance_stops:
            self._turn_again(linear)
            return
        self.result = ApertureResult(
            tolerance_stops=self.tolerance_stops,
            means_dn=_means(looks),
            settings=self._meter.settings,
            linear=linear,
            uneven=Pair(*(each.uneven for each in looks)),
            readings=self._lock.readings,
            plot=histogram_plot(Pair(*map(histogram, frames)), "Grey values of both cameras"),
        )

    def _turn_again(self, linear: Linearity) -> None:
        """The ring moved after it had locked, or the black levels were not yet known so well."""
        self._meter.black_dn = linear.black_dn
        self._lock.release()
        self._steps.clear()
        self.locked = False


def _judge(steps: list[tuple[float, Pair[float]]]) -> Linearity:
    exposures_us, means, errors = [], [], []
    for first in range(0, len(steps), _FRAMES_EACH):
        group = steps[first : first + _FRAMES_EACH]
        sides = np.array([seen for _, seen in group])
        exposures_us.append(group[0][0])
        means.append(Pair(*sides.mean(0).tolist()))
        errors.append(Pair(*(sides.std(0, ddof=1) / np.sqrt(len(group))).tolist()))
    return linearity(exposures_us, means, errors)


def _means(looks: Pair[Look]) -> Pair[float]:
    return Pair(*(each.mean_dn for each in looks))
