"""Noise-aware exposure control by searching the settings themselves (Shin et al. 2019).

Every frame is one evaluation of the metric. A search starts around the settings of a frame, ends
after at most `evaluations_max` of them, and its best settings hold until the metric of a frame
leaves the best by more than the tolerance (thesis 5.2.1, "convergence criterion").
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray

from rig.controllers.arrival import Arrival
from rig.controllers.search import Evaluation, Point, Search, nelder_mead
from rig.controllers.split import brightness_us
from rig.core.autoexposure import AutoExposure
from rig.core.types import (
    Auto,
    Command,
    Diagnostics,
    Frame,
    Limits,
    PixelFormat,
    Settings,
)
from rig.core.units import gain_db, gain_factor
from rig.vision.metrics import SHIN_VARIANTS, ShinScore, mean_dn, sample, shin_at

TOLERANCES: Mapping[str, float] = {"low": 0.02, "mid": 0.05, "high": 0.15}
"""How far the metric may leave the best before a new search; the authors published no numbers."""

UNUSABLE_COST = 1e10
"""What settings outside the limits, and frames without gradients, cost."""

ALPHA = 1.7
GAIN_STEP_MIN_DB = 3.0
EXPOSURE_STEP_MIN = 0.1
"""The least relative change of exposure in the first simplex."""

MIDDLE_DN = 128.0
NEPERS_PER_DB = math.log(10) / 20
FIRST_SPREAD, LAST_SPREAD = 0.2, 0.1
"""A simplex this small in the logarithms of exposure and gain is done: noise decides the rest."""

RIDGE_LOOKS, RIDGE_DARKER = 6, 0.75
RIDGE_STEP, BESIDE_STEP = 1.6, 1.2
"""The second simplex: a factor traded between exposure and gain, and one of brightness."""

SEARCHABLE_DN = (30.0, 225.0)
FROM_BLACK, FROM_WHITE, CENTRINGS_MAX = 8.0, 0.25, 8
"""Before a search a picture beyond these means is brought towards mid-grey, by such factors."""

LOOKS, LUCK = 3, 0.1
"""Frames at rest whose mean metric is kept, and how much luckier the best of a search may be."""

ROUNDING = 1e-9
"""What a logarithm and its inverse may add."""
FLAT_FRAMES_MAX = 3
"""So many frames in a row without gradients end a search: the light has gone."""


@dataclass(slots=True)
class ShinController:
    """Maximises the metric `variant` by Nelder-Mead, one frame an evaluation.

    `tolerance` is low, mid, high or a number > 0; `variant` a key of SHIN_VARIANTS. With `rounds` 1
    a search ends as the authors' does, when the metrics of its simplex differ by at most
    `cost_spread`, or after `evaluations_max`; with more, when its simplex is small, and then looks
    along equal brightness and goes on from the best place there, while that is better.
    A frame without gradients has no metric: until one has, the mean is steered to mid-grey.
    Raises ValueError for an option out of range.
    """

    tolerance: str = "high"
    variant: str = "authors"
    cost_spread: float = 1e-5
    evaluations_max: int = 15
    rounds: int = 1
    _tolerance: float = field(init=False)
    _limits: Limits = field(init=False, default_factory=Limits)
    _command: Settings = field(init=False)
    _rest: Settings = field(init=False)
    _score: ShinScore | None = field(init=False, default=None)
    _search: Search | None = field(init=False, default=None, repr=False)
    _best: Evaluation | None = field(init=False, default=None, repr=False)
    _evaluations: int = field(init=False, default=0)
    _searches: int = field(init=False, default=0)
    _flat_frames: int = field(init=False, default=0)
    _centrings: int = field(init=False, default=0)
    _looks: list[float] = field(init=False, default_factory=list)
    _arrival: Arrival = field(init=False, default_factory=Arrival)

    def __post_init__(self) -> None:
        self._tolerance = _number(self.tolerance)
        if self.variant not in SHIN_VARIANTS:
            close = get_close_matches(self.variant, SHIN_VARIANTS, 1)
            hint = f"did you mean {close[0]!r}? " if close else ""
            raise ValueError(
                f"variant {self.variant!r} is unknown; {hint}known: {', '.join(SHIN_VARIANTS)}"
            )
        if not self.cost_spread >= 0:
            raise ValueError(f"cost_spread must be >= 0, got {self.cost_spread!r}")
        if self.rounds < 1:
            raise ValueError(f"rounds must be >= 1, got {self.rounds!r}")
        if self.evaluations_max < 3:
            raise ValueError(f"evaluations_max must be >= 3, got {self.evaluations_max!r}")
        self._command = self._rest = Auto().start
        _measure(np.zeros((32, 32), np.uint8), "bayer_rggb8", self.variant)  # compiled by now

    def reset(self, limits: Limits) -> Command:
        """Forget the search and return the first settings: 1 ms and 0 dB, inside `limits`."""
        self._limits = limits
        self._command = Auto().start.clamp(limits)
        self._score = self._search = self._best = None
        self._evaluations = self._searches = self._flat_frames = self._centrings = 0
        self._arrival = Arrival()
        return self._command

    def step(self, frame: Frame) -> Command:
        """Take the frame as an evaluation, or hold while its metric stays near the best."""
        self._score = score = _measure(frame.image, frame.pixel_format, self.variant)
        self._flat_frames = self._flat_frames + 1 if score.flat else 0
        if self._search is not None and self._flat_frames < FLAT_FRAMES_MAX:
            return self._continue_search(self._search, frame.used, score)
        if self._best is not None and not self._arrival.due(frame.used, self._command):
            return self._command
        if score.flat:
            return self._steer(frame)
        if self._best is not None and self._is_near(self._best, score.score):
            return self._command
        if self._is_searchable(frame):
            return self._start_search(frame, score)
        return self._centre(frame)

    def diagnostics(self) -> Diagnostics:
        """Return the phase (search, hold, flat or centre), the metric and the search's length."""
        if self._score is None:
            return {}
        return {
            "phase": self._phase(self._score.flat),
            "score": self._score.score,
            "gradient": self._score.gradient,
            "entropy": self._score.entropy,
            "noise_dn": self._score.noise_dn,
            "evaluations": float(self._evaluations),
            "searches": float(self._searches),
        }

    def _phase(self, flat: bool) -> str:
        if self._search is not None:
            return "search"
        if self._best is not None:
            return "hold"
        return "flat" if flat else "centre"

    def _is_near(self, best: Evaluation, score: float) -> bool:
        """Return whether the metric is still that of the best place.

        The best of many noisy looks was a lucky one: the first frames at rest correct it.
        """
        lucky = LUCK if not self._looks else 0.0
        if abs(score + best.cost) > self._tolerance + lucky:
            return False
        if len(self._looks) < LOOKS:
            self._looks.append(score)
            self._best = Evaluation(best.point, -sum(self._looks) / len(self._looks))
        return True

    def _is_searchable(self, frame: Frame) -> bool:
        """Return whether the picture is neither nearly black nor nearly white, or stays so."""
        lowest_dn, highest_dn = SEARCHABLE_DN
        return lowest_dn <= mean_dn(frame.image) <= highest_dn or self._centrings >= CENTRINGS_MAX

    def _centre(self, frame: Frame) -> Command:
        """Go to the middle of the settings that bring the mean to mid-grey."""
        self._search = self._best = None
        self._centrings += 1
        mean = mean_dn(frame.image)
        factor = FROM_WHITE if mean > MIDDLE_DN else min(MIDDLE_DN / max(mean, 1.0), FROM_BLACK)
        self._command = ridge_middle(brightness_us(frame.used) * factor, self._limits)
        return self._command

    def _steer(self, frame: Frame) -> Command:
        """Give up searching and move the mean to mid-grey."""
        self._search = self._best = None
        law = AutoExposure(self._limits, MIDDLE_DN, 0.0, frame.used)
        self._command = law.after(mean_dn(frame.image)).settings
        return self._command

    def _start_search(self, frame: Frame, score: ShinScore) -> Command:
        """Begin around the frame's settings, which are the first evaluation."""
        corners = initial_simplex(frame.used, mean_dn(frame.image), self._limits)
        first, *others = [_point(Settings(*corner)) for corner in corners]
        self._best = Evaluation(first, -score.score)
        self._rest = frame.used.clamp(self._limits)
        self._evaluations, self._searches = 1, self._searches + 1
        self._centrings, self._looks = 0, []
        self._search = self._all_rounds(self._best, others)
        return self._ask(self._search, next(self._search))

    def _continue_search(self, search: Search, used: Settings, score: ShinScore) -> Command:
        """Stamp the metric with the settings that were really used, once they have arrived."""
        if not self._arrival.due(used, self._command):
            return self._command
        evaluation = Evaluation(_point(used), UNUSABLE_COST if score.flat else -score.score)
        if self._best is None or evaluation.cost < self._best.cost:
            self._best, self._rest = evaluation, used.clamp(self._limits)
        return self._answer(search, evaluation)

    def _all_rounds(self, first: Evaluation, others: list[Point]) -> Search:
        """Search as the authors do; then along equal brightness while that finds better.

        The metric has a narrow ridge there, on which noise makes a simplex shrink too early.
        """
        once = self.rounds == 1
        best = yield from nelder_mead(
            others,
            known=[first],
            point_spread=math.inf if once else FIRST_SPREAD,
            cost_spread=self.cost_spread if once else math.inf,
        )
        for _ in range(self.rounds - 1):
            before = best.cost
            best = yield from ridge_round(best, self._limits)
            if best.cost >= before:
                break
        return best

    def _answer(self, search: Search, evaluation: Evaluation) -> Command:
        """Tell the search of an evaluation; return what to do next."""
        self._evaluations += 1
        if self._evaluations >= self.evaluations_max:
            return self._settle()
        try:
            return self._ask(search, search.send(evaluation))
        except StopIteration:
            return self._settle()

    def _ask(self, search: Search, asked: Point) -> Command:
        """Try what the search asks for; what is outside the limits costs no frame."""
        if not _inside(asked, self._limits):
            return self._answer(search, Evaluation(asked, UNUSABLE_COST))
        self._command = _settings(asked).clamp(self._limits)
        return self._command

    def _settle(self) -> Command:
        """Rest on the best frame that was seen."""
        self._search = None
        self._command = self._rest
        return self._command


def initial_simplex(used: Settings, mean_dn: float, limits: Limits) -> list[tuple[float, float]]:
    """Return the settings used, with another gain, and with another exposure.

    Both are scaled by the authors' 1 + h: h rises to 1.7 for a black picture and falls to -0.59
    for a white one. Scaling cannot move 0 dB, nor settings at their limit: those move by a least
    step, to the other side where there is no room.
    """
    h = -mean_dn / (255 * ALPHA) if mean_dn >= MIDDLE_DN else ALPHA * (1 - mean_dn / 255)
    start = used.clamp(limits)
    exposure_us, gain_db = start.exposure_us, start.gain_db
    other_gain = _moved(gain_db, gain_db * h, math.copysign(GAIN_STEP_MIN_DB, h), limits.gain_db)
    least_us = math.copysign(EXPOSURE_STEP_MIN * exposure_us, h)
    other_exposure = _moved(exposure_us, exposure_us * h, least_us, limits.exposure_us)
    return [(exposure_us, gain_db), (exposure_us, other_gain), (other_exposure, gain_db)]


def ridge_round(best: Evaluation, limits: Limits) -> Search:
    """Look along equal brightness from end to end, then search around the best place of all."""
    seen = [best]
    for settings in ridge(_settings(best.point).clamp(limits), limits):
        seen.append((yield _point(settings)))
    best = min(seen, key=lambda evaluation: evaluation.cost)
    beside = beside_simplex(_settings(best.point).clamp(limits), limits)
    return (
        yield from nelder_mead(
            [_point(corner) for corner in beside],
            known=[best],
            point_spread=LAST_SPREAD,
            cost_spread=math.inf,
        )
    )


def ridge(best: Settings, limits: Limits) -> list[Settings]:
    """Return settings from the shortest exposure to the longest, by turns darker and as bright.

    Darker, because amplified noise saturates sooner: the best brightness falls with gain.
    """
    return [
        _on_ridge(
            brightness_us(best) * (RIDGE_DARKER if look % 2 == 0 else 1.0),
            look / (RIDGE_LOOKS - 1),
            limits,
        )
        for look in range(RIDGE_LOOKS)
    ]


def ridge_middle(brightness_us: float, limits: Limits) -> Settings:
    """Return the middle, in logarithms, of all settings that are so bright."""
    return _on_ridge(brightness_us, 0.5, limits)


def _on_ridge(brightness_us: float, share: float, limits: Limits) -> Settings:
    """Return settings of a brightness: 0 with the shortest exposure, 1 with the longest."""
    shortest_us, longest_us = limits.exposure_us
    least, most = (gain_factor(gain) for gain in limits.gain_db)
    possible_us = min(max(brightness_us, shortest_us * least), longest_us * most)
    first_us, last_us = max(shortest_us, possible_us / most), min(longest_us, possible_us / least)
    exposure_us = first_us * (last_us / first_us) ** share
    return Settings(exposure_us, gain_db(max(possible_us / exposure_us, 1.0))).clamp(limits)


def beside_simplex(best: Settings, limits: Limits) -> list[Settings]:
    """Return as bright settings with another gain, and some a little brighter.

    Where a limit leaves no room the step goes to the other side.
    """
    trade_db = gain_db(RIDGE_STEP)
    along = Settings(best.exposure_us / RIDGE_STEP, best.gain_db + trade_db)
    if along.clamp(limits) != along:
        along = Settings(best.exposure_us * RIDGE_STEP, max(best.gain_db - trade_db, 0.0))
    beside = Settings(best.exposure_us * BESIDE_STEP, best.gain_db)
    if beside.clamp(limits) != beside:
        beside = Settings(best.exposure_us / BESIDE_STEP, best.gain_db)
    return [corner.clamp(limits) for corner in (along, beside)]


def _moved(value: float, change: float, least: float, limits: tuple[float, float]) -> float:
    """Return `value` changed inside the limits, by `least` at least where they leave room."""
    moved = min(max(value + change, limits[0]), limits[1])
    if abs(moved - value) >= abs(least):
        return moved
    for candidate in (value + least, value - least):
        if limits[0] <= candidate <= limits[1]:
            return candidate
    return max(limits, key=lambda limit: abs(limit - value))


def _measure(image: NDArray[np.uint8], pixel_format: PixelFormat, variant: str) -> ShinScore:
    """Return the metric of a sample of the picture."""
    part = sample(image, pixel_format)
    return shin_at(part.colour(), part.places, variant)


def _inside(point: Point, limits: Limits) -> bool:
    (shortest_us, longest_us), (lowest_db, highest_db) = limits.exposure_us, limits.gain_db
    exposure_us, gain_db = math.exp(point[0]), point[1] / NEPERS_PER_DB
    within = shortest_us * (1 - ROUNDING) <= exposure_us <= longest_us * (1 + ROUNDING)
    return bool(within and lowest_db - ROUNDING <= gain_db <= highest_db + ROUNDING)


def _point(settings: Settings) -> Point:
    """Return where settings lie in the search: the logarithms of exposure and of gain."""
    return np.array([math.log(settings.exposure_us), settings.gain_db * NEPERS_PER_DB])


def _settings(point: Point) -> Settings:
    return Settings(math.exp(point[0]), max(float(point[1]) / NEPERS_PER_DB, 0.0))


def _number(tolerance: str) -> float:
    """Return the number that a tolerance means."""
    try:
        value = TOLERANCES[tolerance] if tolerance in TOLERANCES else float(tolerance)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise ValueError(
            f"tolerance must be {', '.join(TOLERANCES)} or a number > 0, got {tolerance!r}"
        )
    return value
