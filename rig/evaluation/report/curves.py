"""The curves of the drive as plain numbers, for the page's script to draw."""

from __future__ import annotations

from typing import Any

import numpy as np

from rig.evaluation.report.wording import FRONT_END_NAMES, labels
from rig.evaluation.series import Column
from rig.evaluation.statistics import BLIND_BELOW, WARM_UP_PAIRS
from rig.evaluation.summary import RACE_SIDES, RaceSide, Summary

DRIVE, INTERNALS, PAIRS = "charts", "internal-charts", "pair-charts"
"""The elements of the page that charts are drawn in."""


def curves(summary: Summary) -> dict[str, Any]:
    """Return what charts.js reads: shared columns, and one chart a quantity; None is no value.

    A logarithmic chart has no place for values <= 0, so they are None there.
    """
    series = summary.series
    trigger = series.trigger
    return {
        "pair": trigger.tolist(),
        "time_s": _plain(series.time_s),
        "incomplete": [int(k) for k, cause in zip(trigger, series.cause, strict=True) if cause],
        "warm_up": WARM_UP_PAIRS,
        "segments": [
            {"kind": part.kind, "first": int(trigger[part.first]), "last": int(trigger[part.last])}
            for part in summary.segments
        ],
        "charts": [*_drive(summary), *_internals(summary), *_pairs(summary)],
    }


def _drive(summary: Summary) -> list[dict[str, Any]]:
    left, right = summary.camera("left"), summary.camera("right")
    charts = [
        _chart(
            f"{FRONT_END_NAMES[name]} inliers",
            "",
            _both(summary, left.inliers[name], right.inliers[name]),
            threshold=BLIND_BELOW[name],
        )
        for name in left.inliers
    ]
    for title, unit, field, log in (
        ("Exposure", "µs", "exposure_us", True),
        ("Gain", "dB", "gain_db", False),
        ("Mean grey", "0–255", "mean_grey_dn", False),
        ("Decision", "ms", "decision_ms", True),
    ):
        columns = _both(summary, getattr(left, field), getattr(right, field), log=log)
        charts.append(_chart(title, unit, columns, log=log))
    light = summary.series.light_cd_m2
    if not np.isnan(light).all():
        curve = _curve("soft", "primary's view", light, log=True)
        charts.append(_chart("Light of the scene, simulated", "cd/m²", [curve], log=True))
    return charts


def _internals(summary: Summary) -> list[dict[str, Any]]:
    """Return a chart for each number that a controller told of itself."""
    names = _names(summary)
    return [
        _chart(name.replace("_", " "), "", [_curve(side, names[side], column)], host=INTERNALS)
        for side in RACE_SIDES
        for name, column in summary.camera(side).thoughts.items()
        if not np.isnan(column).all()
    ]


def _pairs(summary: Summary) -> list[dict[str, Any]]:
    offset = summary.series.offset_us
    if np.isnan(offset).all():
        return []
    curve = _curve("soft", "secondary minus primary", offset)
    return [_chart("Start of exposure", "µs", [curve], host=PAIRS)]


def _chart(
    title: str,
    unit: str,
    drawn: list[dict[str, Any]],
    *,
    log: bool = False,
    threshold: int | None = None,
    host: str = DRIVE,
) -> dict[str, Any]:
    return {
        "title": title,
        "unit": unit,
        "log": log,
        "tall": threshold is not None,
        "threshold": threshold,
        "host": host,
        "curves": drawn,
    }


def _both(
    summary: Summary, left: Column, right: Column, *, log: bool = False
) -> list[dict[str, Any]]:
    names = _names(summary)
    return [
        _curve(side, names[side], column, log=log)
        for side, column in zip(RACE_SIDES, (left, right), strict=True)
    ]


def _names(summary: Summary) -> dict[RaceSide, str]:
    both = labels(summary.left.controller, summary.right.controller)
    return dict(zip(RACE_SIDES, both, strict=True))


def _curve(side: str, name: str, values: Column, *, log: bool = False) -> dict[str, Any]:
    return {"side": side, "name": name, "values": _plain(values, log=log)}


def _plain(values: Column, *, log: bool = False) -> list[float | None]:
    """Return values with five significant digits, and None for what cannot be drawn."""
    return [
        None if not np.isfinite(value) or (log and value <= 0) else float(f"{value:.5g}")
        for value in values
    ]
