"""report.html: one file that needs nothing else, made from a summary and its recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from rig.evaluation.report.curves import INTERNALS, curves
from rig.evaluation.report.internals import spoken
from rig.evaluation.report.moments import MOST_LINES, Moment, moments
from rig.evaluation.report.scatter import scatter
from rig.evaluation.report.tiles import tiles
from rig.evaluation.report.verdict import nearness, verdict
from rig.evaluation.report.ways import ways
from rig.evaluation.report.wording import FRONT_END_NAMES, data, labels, options, significant
from rig.evaluation.statistics import BLIND_BELOW, WARM_UP_PAIRS, counted, spread
from rig.evaluation.summary import RACE_SIDES, RaceSide, Recorded, Summary, at

HERE = Path(__file__).parent


def write_report(
    path: Path, recording: Recorded, summary: Summary, *, pictures: bool = True
) -> None:
    """Write `recording`, summarised as `summary`, to `path` as one offline page.

    The page asks no other file or address for anything, in light and dark. Reads the recording
    once more for its pictures, unless it is to have none. An existing file is replaced.
    """
    path.write_text(render(recording, summary, pictures=pictures), encoding="utf-8")


def render(recording: Recorded, summary: Summary, *, pictures: bool = True) -> str:
    """Return the page as text."""
    shown = moments(summary, recording.records()) if pictures else []
    return (
        environment()
        .get_template("template.html")
        .render(_who(summary) | _what(summary, shown) | _proof(summary) | assets())
    )


def environment() -> Environment:
    """Return what fills the pages' templates: everything is escaped, nothing may be missing."""
    made = Environment(
        loader=FileSystemLoader(HERE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {"value": data, "significant": significant, "options": options}
    return made


def _who(summary: Summary) -> dict[str, Any]:
    """Return who drove what, and what to call them."""
    header = summary.header
    names = labels(summary.left.controller, summary.right.controller)
    right_side = summary.wired("right")
    return {
        "header": header,
        "simulated": "sim" in header.cameras.split("?")[0].split(":"),
        "race": header.command.startswith("rig race "),
        "control": summary.left.controller == summary.right.controller,
        "left": summary.left,
        "right": summary.right,
        "sides": list(zip(RACE_SIDES, (summary.left, summary.right), strict=True)),
        "labels": dict(zip(RACE_SIDES, names, strict=True)),
        "left_side": summary.left_side,
        "right_side": right_side,
        "left_serial": at(header.serials, summary.left_side),
        "right_serial": at(header.serials, right_side),
        "front_ends": {name: FRONT_END_NAMES[name] for name in summary.left.inliers},
    }


def _what(summary: Summary, shown: Sequence[Moment]) -> dict[str, Any]:
    """Return what came of it: numbers, curves, pictures, the map."""
    series = summary.series
    drawn = curves(summary)
    pictures = [picture for moment in shown for picture in (moment.left, moment.right)]
    return {
        "verdict": verdict(summary),
        "nearness": nearness(summary),
        "tiles": tiles(summary),
        "counted": len(counted(series.trigger, summary.camera("left").inliers["orb"])),
        "parts": _parts(summary),
        "warm_up": WARM_UP_PAIRS,
        "blind_below": BLIND_BELOW,
        "moments": shown,
        "most_lines": MOST_LINES,
        "thinned": any(drawn.inliers > MOST_LINES for p in pictures for drawn in p.drawn),
        "scatter": scatter(summary),
        "map": ways(summary),
        "odometry": [
            (side, told.as_json()["odometry"], told.as_json()["viso2"])
            for side, told in zip(RACE_SIDES, (summary.left, summary.right), strict=True)
            if told.odometry is not None
        ],
        "series": drawn,
        "internal_charts": any(chart["host"] == INTERNALS for chart in drawn["charts"]),
        "spoken": spoken(summary),
    }


def _parts(summary: Summary) -> list[tuple[str, int, list[tuple[RaceSide, Any]]]]:
    """Return (name, counted pairs, statistics of both sides) for the drive and each light."""
    sides = list(zip(RACE_SIDES, (summary.left, summary.right), strict=True))
    pairs = len(counted(summary.series.trigger, summary.camera("left").inliers["orb"]))
    parts: list[tuple[str, int, list[tuple[RaceSide, Any]]]] = [
        ("drive", pairs, [(name, side.inliers) for name, side in sides])
    ]
    kinds = summary.left.segments
    if len(kinds) > 1:
        parts += [
            (kind, part.pairs, [(name, side.segments[kind].inliers) for name, side in sides])
            for kind, part in kinds.items()
        ]
    return parts


def _proof(summary: Summary) -> dict[str, Any]:
    """Return what shows that the pairs are pairs, and what is missing."""
    series = summary.series
    offsets = series.offset_us[~np.isnan(series.offset_us)]
    return {
        "frames": len(series),
        "pairs_complete": summary.pairs_complete,
        "drops": summary.drops,
        "incomplete": [
            int(k) for k, cause in zip(series.trigger, series.cause, strict=True) if cause
        ],
        "offset_us": {
            "median": spread(offsets)[1],
            "furthest": float(offsets[np.argmax(np.abs(offsets))]) if offsets.size else None,
        },
    }


def assets() -> dict[str, Any]:
    """Return the style and the scripts, to be written into the page."""
    return {
        "style": _inline("style.css"),
        "script": _inline("charts.js"),
        "chart_style": _inline("uplot/uPlot.min.css"),
        "chart_script": _without_banner(_inline("uplot/uPlot.iife.min.js")),
        "chart_licence": _inline("uplot/LICENSE.md"),
    }


def _inline(name: str) -> Markup:
    return Markup((HERE / name).read_text(encoding="utf-8").strip())


def _without_banner(script: Markup) -> Markup:
    """Return the script without its first comment, which holds an address."""
    return Markup(script.partition("*/")[2].strip())
