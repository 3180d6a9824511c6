"""Exposure and gain by Bayesian optimisation of Kim's metric, one frame an evaluation.

A search looks at up to `evaluations_max` places of the authors' 39 x 13 grid, each chosen by their
MAXMI acquisition over a Gaussian process, and rests where the metric is believed best until the
metric of a frame leaves it by more than `keep` (Kim et al. 2018 and 2020; thesis eq. 3.7).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rig.controllers.arrival import Arrival
from rig.controllers.gaussian import Points, maxmi, posterior, squared_distances
from rig.core.types import Auto, Command, Diagnostics, Frame, Limits, Settings
from rig.core.units import gain_factor
from rig.vision.bayer import to_grey
from rig.vision.metrics import kim

GRID = (39, 13)
"""Exposures, geometric between the limits, and gains, even up to `gain_db_max`."""


@dataclass(slots=True)
class KimController:
    """Maximises the entropy-weighted gradient by Gaussian-process search.

    `alpha` weighs exploration; `length` is the kernel's, in grid steps, `ridge` times as long along
    equal brightness; `noise` is the deviation of an observation, where that of all observations is
    1. `keep` is the relative change of the metric
    that starts a new search. Raises ValueError for an option out of range.
    """

    evaluations_max: int = 10
    alpha: float = 50.0
    length: float = 15.5
    ridge: float = 1.0
    noise: float = 0.05
    keep: float = 0.5
    gain_db_max: float = 12.0
    _limits: Limits = field(init=False, default_factory=Limits)
    _command: Settings = field(init=False)
    _looked: bool = field(init=False, default=False)
    _metric: float = field(init=False, default=0.0)
    _points: list[tuple[float, float]] = field(init=False, default_factory=list)
    _values: list[float] = field(init=False, default_factory=list)
    _seen: list[tuple[float, Settings]] = field(init=False, default_factory=list)
    _psi: float = field(init=False, default=0.0)
    _deviation: float = field(init=False, default=1.0)
    _phase: str = field(init=False, default="")
    _best: float = field(init=False, default=0.0)
    _searches: int = field(init=False, default=0)
    _arrival: Arrival = field(init=False, default_factory=Arrival)

    def __post_init__(self) -> None:
        if self.evaluations_max < 2:
            raise ValueError(f"evaluations_max must be >= 2, got {self.evaluations_max!r}")
        for name in ("alpha", "length", "ridge", "noise", "keep"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise ValueError(f"{name} must be > 0, got {value!r}")
        Settings(1.0, self.gain_db_max)
        self._command = Auto().start
        kim(np.zeros((32, 32), np.uint8))  # compiled before the first frame

    def reset(self, limits: Limits) -> Command:
        """Forget the search and return the first settings: 1 ms and 0 dB, inside `limits`."""
        self._limits = limits
        self._command = Auto().start.clamp(limits)
        self._looked, self._metric, self._searches = False, 0.0, 0
        self._arrival = Arrival()
        self._begin()
        return self._command

    def step(self, frame: Frame) -> Command:
        """Take the frame as an evaluation, or hold while its metric stays near the best."""
        self._looked = True
        self._metric = kim(to_grey(frame.image, frame.pixel_format))
        if not self._arrival.due(frame.used, self._command):
            return self._command
        if self._phase == "hold":
            if abs(self._metric - self._best) <= self.keep * max(abs(self._best), 1.0):
                return self._command
            self._begin()
        elif self._phase == "settle":
            return self._settle(frame.used)
        return self._evaluate(frame.used)

    def diagnostics(self) -> Diagnostics:
        """Return the phase (search, settle or hold), the metric and the state of the surrogate."""
        if not self._looked:
            return {}
        return {
            "phase": self._phase,
            "metric": self._metric,
            "evaluations": float(len(self._values)),
            "searches": float(self._searches),
            "surrogate_psi": self._psi,
            "surrogate_deviation": self._deviation,
        }

    def _begin(self) -> None:
        self._points, self._values, self._seen, self._psi = [], [], [], 0.0
        self._phase = "search"

    def _evaluate(self, used: Settings) -> Settings:
        """Add an observation; return the next place to look, or the best when it was the last."""
        if not self._values:
            self._searches += 1
        self._points.append(self._place(used.clamp(self._limits)))
        self._values.append(self._metric)
        self._seen.append((self._metric, used.clamp(self._limits)))
        values = np.maximum(self._values, 0.0)  # how badly saturated a place is, teaches nothing
        spread = float(values.std())
        standard = (values - values.mean()) / (spread if spread > 0 else 1.0)
        grid = _grid()
        points, candidates = self._shortened(np.array(self._points)), self._shortened(grid)
        belief = posterior(points, standard, candidates, self.length, self.noise)
        if len(values) >= self.evaluations_max:
            choice, self._phase = int(np.argmax(belief.mean)), "settle"
        else:
            worth = maxmi(belief, self.alpha, self._psi)
            worth[self._looked_at(grid)] = -np.inf
            choice = int(np.argmax(worth))
            self._psi += float(belief.variance[choice])
        self._deviation = float(np.sqrt(belief.variance.max()))
        self._command = self._settings(grid[choice])
        return self._command

    def _shortened(self, points: Points) -> Points:
        """Return places with their distances along equal brightness divided by `ridge`.

        Settings as bright as each other give nearly the same picture: one tells of the other.
        """
        (shortest_us, longest_us), (lowest_db, highest_db) = self._ranges()
        exposure_step = np.log(longest_us / shortest_us) / (GRID[0] - 1)
        gain_step = np.log(gain_factor(highest_db - lowest_db)) / (GRID[1] - 1)
        ridge = np.array([gain_step, -exposure_step]) / (np.hypot(gain_step, exposure_step) or 1.0)
        return points - (1 - 1 / self.ridge) * np.outer(points @ ridge, ridge)

    def _looked_at(self, grid: Points) -> list[int]:
        """Return the places of the grid nearest to those looked at: nothing is looked at twice."""
        nearest = squared_distances(np.array(self._points), grid).argmin(axis=1)
        return [int(place) for place in nearest]

    def _settle(self, used: Settings) -> Settings:
        """Rest where the surrogate promised most, unless a place looked at was better."""
        seen = [*self._seen, (self._metric, used.clamp(self._limits))]
        self._best, self._command = max(seen, key=lambda look: look[0])
        self._phase = "hold"
        return self._command

    def _ranges(self) -> tuple[tuple[float, float], tuple[float, float]]:
        lowest_db, highest_db = self._limits.gain_db
        capped_db = max(min(self.gain_db_max, highest_db), lowest_db)
        return self._limits.exposure_us, (lowest_db, capped_db)

    def _place(self, used: Settings) -> tuple[float, float]:
        """Return where settings lie on the grid, in steps."""
        (shortest_us, longest_us), (lowest_db, highest_db) = self._ranges()
        octaves, range_db = np.log(longest_us / shortest_us), highest_db - lowest_db
        along = np.log(used.exposure_us / shortest_us) / octaves if octaves > 0 else 0.0
        up = (used.gain_db - lowest_db) / range_db if range_db > 0 else 0.0
        return float(along) * (GRID[0] - 1), float(up) * (GRID[1] - 1)

    def _settings(self, place: Points) -> Settings:
        (shortest_us, longest_us), (lowest_db, highest_db) = self._ranges()
        along, up = float(place[0]) / (GRID[0] - 1), float(place[1]) / (GRID[1] - 1)
        exposure_us = shortest_us * (longest_us / shortest_us) ** along
        return Settings(exposure_us, lowest_db + up * (highest_db - lowest_db)).clamp(self._limits)


def _grid() -> Points:
    along, up = np.meshgrid(np.arange(GRID[0]), np.arange(GRID[1]), indexing="ij")
    return np.column_stack([along.ravel(), up.ravel()]).astype(np.float64)
