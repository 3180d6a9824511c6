"""Gain over exposure time, one dot a picture: where each controller has been."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rig.evaluation.report.wording import number
from rig.evaluation.statistics import WARM_UP_PAIRS
from rig.evaluation.summary import RACE_SIDES, RaceSide, Summary

MOST_DOTS = 600


@dataclass(frozen=True, slots=True)
class Tick:
    """A grid line at an SVG coordinate."""

    at: float
    label: str


@dataclass(frozen=True, slots=True)
class Dot:
    """One picture's settings in SVG coordinates."""

    side: RaceSide
    x: float
    y: float
    label: str


@dataclass(frozen=True, slots=True)
class Scatter:
    """An SVG plot: size, the edges of its frame, grid lines and dots."""

    dots: list[Dot]
    x_ticks: list[Tick]
    y_ticks: list[Tick]
    width: int = 480
    height: int = 330
    left: int = 42
    right: int = 466
    top: int = 26
    bottom: int = 280


def scatter(summary: Summary) -> Scatter:
    """Return the plot of all counted pictures, at most MOST_DOTS a side, exposure on a log axis."""
    frame = Scatter([], [], [])
    points = [(side, *point) for side in RACE_SIDES for point in _settings(summary, side)]
    exposures = [point[2] for point in points] or [75.0, 30_000.0]
    low = math.log10(min(exposures)) - 0.08
    high = math.log10(max(exposures)) + 0.08
    top_db = max([point[3] for point in points] + [6.0]) * 1.06

    def x(exposure_us: float) -> float:
        share = (math.log10(exposure_us) - low) / (high - low)
        return round(frame.left + share * (frame.right - frame.left), 1)

    def y(gain_db: float) -> float:
        return round(frame.bottom - gain_db / top_db * (frame.bottom - frame.top), 1)

    step_db = next(step for step in (2, 3, 5, 10) if top_db / step <= 7)
    return Scatter(
        dots=[
            Dot(
                side,
                x(exposure),
                y(gain),
                f"pair {pair}: {number(exposure, 0)} µs, {number(gain, 1)} dB",
            )
            for side, pair, exposure, gain in points
        ],
        x_ticks=[Tick(x(value), number(value)) for value in _decades(low, high)],
        y_ticks=[Tick(y(value), str(value)) for value in range(0, math.floor(top_db) + 1, step_db)],
    )


def _settings(summary: Summary, side: RaceSide) -> list[tuple[int, float, float]]:
    """Return (trigger, exposure_us, gain_db) of the counted pictures, evenly thinned."""
    camera, trigger = summary.camera(side), summary.series.trigger
    kept = np.flatnonzero((trigger >= WARM_UP_PAIRS) & ~np.isnan(camera.exposure_us))
    kept = kept[:: max(math.ceil(len(kept) / MOST_DOTS), 1)]
    return [(int(trigger[i]), camera.exposure_us[i], camera.gain_db[i]) for i in kept]


def _decades(low: float, high: float) -> list[float]:
    """Return round values between two base-10 logarithms: 1, 2, 5 a decade, or 1 when many."""
    steps = (1, 2, 5) if high - low < 2 else (1, 3) if high - low < 3 else (1,)
    values = [
        step * 10.0**exponent
        for exponent in range(math.floor(low), math.ceil(high) + 1)
        for step in steps
    ]
    return [value for value in values if low <= math.log10(value) <= high]
