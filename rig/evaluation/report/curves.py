"""The curves of the drive as plain numbers, for the page's script to draw."""

from __future__ import annotations

from typing import Any

import numpy as np

from rig.evaluation.report.wording import FRONT_END_NAMES, labels
from rig.evaluation.series import Column
from rig.evaluation.statistics import BLIND_BELOW, WARM_UP_PAIRS
from rig.evaluation.summary import Summary


def curves(summary: Summary) -> dict[str, Any]:
    """Return what charts.js reads: shared columns, and one chart a quantity; None is no value.

    A logarithmic chart has no place for values <= 0, so they are None there.
    """
    series = summary.series
    left, right = summary.camera("left"), summary.camera("right")
    charts = [
        *(
            _chart(
                summary,
                f"{FRONT_END_NAMES[name]} inliers",
                "",
                left.inliers[name],
                right.inliers[name],
                threshold=BLIND_BELOW[name],
            )
            for name in left.inliers
        ),
        _chart(summary, "Exposure", "µs", left.exposure_us, right.exposure_us, log=True),
        _chart(summary, "Gain", "dB", left.gain_db, right.gain_db),
        _chart(summary, "Mean grey", "0–255", left.mean_grey_dn, right.mean_grey_dn),
        _chart(summary, "Decision", "ms", left.decision_ms, right.decision_ms, log=True),
    ]
    if not np.isnan(series.light_cd_m2).all():
        charts.append(_scene_light(series.light_cd_m2))
    return {
        "pair": series.trigger.tolist(),
        "time_s": _plain(series.time_s),
        "incomplete": [
            int(trigger)
            for trigger, cause in zip(series.trigger, series.cause, strict=True)
            if cause
        ],
        "warm_up": WARM_UP_PAIRS,
        "charts": charts,
    }


def _chart(
    summary: Summary,
    title: str,
    unit: str,
    left: Column,
    right: Column,
    *,
    log: bool = False,
    threshold: int | None = None,
) -> dict[str, Any]:
    names = labels(summary.left.controller, summary.right.controller)
    return {
        "title": title,
        "unit": unit,
        "log": log,
        "tall": threshold is not None,
        "threshold": threshold,
        "curves": [
            {"side": "left", "name": names[0], "values": _plain(left, log=log)},
            {"side": "right", "name": names[1], "values": _plain(right, log=log)},
        ],
    }


def _scene_light(light_cd_m2: Column) -> dict[str, Any]:
    return {
        "title": "Light of the scene, simulated",
        "unit": "cd/m²",
        "log": True,
        "tall": False,
        "threshold": None,
        "curves": [
            {"side": "soft", "name": "primary's view", "values": _plain(light_cd_m2, log=True)}
        ],
    }


def _plain(values: Column, *, log: bool = False) -> list[float | None]:
    """Return values with five significant digits, and None for what cannot be drawn."""
    return [
        None if np.isnan(value) or (log and value <= 0) else float(f"{value:.5g}")
        for value in values
    ]
