"""Where a drive is steady, approaches the dark, is inside it, or leaves it: by the light alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from rig.evaluation.series import RunSeries

Column = NDArray[np.float64]
Kind = Literal["static", "approaching", "inside", "leaving"]
KINDS: tuple[Kind, ...] = get_args(Kind)

CONTRAST_MIN = 4.0
"""A drive whose light changes by less, two stops, has no inside and no outside."""

RUN_MIN_PAIRS = 5
"""A shorter change of the light is a shadow or a lamp, not a tunnel."""

PLATEAU_SHARE = 0.25
"""A transition begins and ends this share of its stops away from the light on either side."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of rows, `first` to `last` inclusive, of one kind."""

    kind: Kind
    first: int
    last: int


def light_level(series: RunSeries) -> Column:
    """Return how bright the scene was at every row, in any unit, NaN where nothing came.

    The simulation's true radiance where it is known. Otherwise what the pictures tell: mean grey
    over exposure time and gain, of the camera whose picture is nearer to middle grey, as the
    further one may be cut off at black or white.
    """
    if not np.isnan(series.light_cd_m2).all():
        return series.light_cd_m2
    levels, badness = [], []
    for camera in series.cameras:
        grey = np.maximum(camera.mean_grey_dn, 1.0)
        levels.append(grey / (camera.exposure_us * 10 ** (camera.gain_db / 20)))
        badness.append(np.abs(camera.mean_grey_dn - 128))
    return np.where(badness[0] <= badness[1], levels[0], levels[1])


def segments(light: Column) -> list[Segment]:
    """Return the stretches of a drive in order; together they hold every row of `light`.

    The halfway level between the drive's dark and bright (5th and 95th percentile, in stops)
    divides inside from outside. A transition is what lies between leaving a quarter of the way
    from one side's median and coming within a quarter of the other's. Outside is `static`.
    """
    stops = _smooth(np.log2(_filled(light)))
    if stops.size == 0:
        return []
    dark, bright = np.percentile(stops, (5, 95))
    if bright - dark < np.log2(CONTRAST_MIN):
        return [Segment("static", 0, len(stops) - 1)]
    runs = _runs(stops < (dark + bright) / 2)
    kinds: list[Kind] = [
        "inside" if is_dark else "static"
        for is_dark, first, last in runs
        for _ in range(first, last + 1)
    ]
    for before, after in pairwise(runs):
        kind: Kind = "approaching" if after[0] else "leaving"
        for row in _transition(stops, before, after):
            kinds[row] = kind
    return list(_stretches(kinds))


def kinds_by_row(found: Sequence[Segment], rows: int) -> list[Kind]:
    """Return the kind of each of `rows` rows."""
    kinds: list[Kind] = ["static"] * rows
    for segment in found:
        kinds[segment.first : segment.last + 1] = [segment.kind] * (
            segment.last + 1 - segment.first
        )
    return kinds


def _filled(light: Column) -> Column:
    """Return positive light everywhere: gaps take the straight line between their neighbours."""
    known = np.flatnonzero(np.isfinite(light) & (light > 0))
    if known.size == 0:
        return np.ones(len(light))
    return np.asarray(np.interp(np.arange(len(light)), known, light[known]))


def _smooth(stops: Column) -> Column:
    """Return the running median over five rows: what is shorter than three is gone."""
    if len(stops) < 5:
        return stops
    padded = np.pad(stops, 2, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1))


Run = tuple[bool, int, int]


def _runs(dark: NDArray[np.bool_]) -> list[Run]:
    """Return (dark, first, last) of stretches, the short ones dissolved into their neighbours."""
    runs: list[Run] = []
    row = 0
    for is_dark, group in groupby(dark.tolist()):
        length = sum(1 for _ in group)
        if runs and (length < RUN_MIN_PAIRS or runs[-1][0] == is_dark):
            is_dark, first, _ = runs.pop()
            runs.append((is_dark, first, row + length - 1))
        else:
            runs.append((is_dark, row, row + length - 1))
        row += length
    if len(runs) > 1 and runs[0][2] - runs[0][1] + 1 < RUN_MIN_PAIRS:
        runs[:2] = [(runs[1][0], 0, runs[1][2])]
    return runs


def _transition(stops: Column, before: Run, after: Run) -> range:
    """Return the rows between two steady lights, around the border of their stretches."""
    from_stops, to_stops = (float(np.median(stops[a : b + 1])) for _, a, b in (before, after))
    near = PLATEAU_SHARE * abs(to_stops - from_stops)
    left = _rows_near(stops[before[1] : before[2] + 1], from_stops, near)
    right = _rows_near(stops[after[1] : after[2] + 1], to_stops, near)
    return range(before[1] + int(left[-1]) + 1, after[1] + int(right[0]))


def _rows_near(stops: Column, level: float, near: float) -> NDArray[np.intp]:
    """Return the rows within `near` of a level; the nearest ones where there are none."""
    apart = np.abs(stops - level)
    return np.flatnonzero(apart <= max(near, float(apart.min())))


def _stretches(kinds: Sequence[Kind]) -> Iterator[Segment]:
    row = 0
    for kind, group in groupby(kinds):
        length = sum(1 for _ in group)
        yield Segment(kind, row, row + length - 1)
        row += length
