"""report.html: one file that needs nothing else, made from a summary and its recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from rig.evaluation.report.curves import curves
from rig.evaluation.report.moments import MOST_LINES, moments
from rig.evaluation.report.scatter import scatter
from rig.evaluation.report.verdict import verdict
from rig.evaluation.report.wording import FRONT_END_NAMES, data, labels, options, significant
from rig.evaluation.statistics import BLIND_BELOW, WARM_UP_PAIRS, counted, spread
from rig.evaluation.summary import RACE_SIDES, Recorded, Summary, at

HERE = Path(__file__).parent


def write_report(path: Path, recording: Recorded, summary: Summary) -> None:
    """Write `recording`, summarised as `summary`, to `path` as one offline page.

    The page asks no other file or address for anything, in light and dark. Reads the recording
    once more for its pictures. An existing file is replaced.
    """
    path.write_text(render(recording, summary), encoding="utf-8")


def render(recording: Recorded, summary: Summary) -> str:
    """Return the page as text."""
    environment = Environment(
        loader=FileSystemLoader(HERE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"value": data, "significant": significant, "options": options}
    return environment.get_template("template.html").render(_context(recording, summary))


def _context(recording: Recorded, summary: Summary) -> dict[str, Any]:
    header, series = summary.header, summary.series
    shown = moments(summary, recording.records())
    drawn = curves(summary)
    names = labels(summary.left.controller, summary.right.controller)
    offsets = series.offset_us[~np.isnan(series.offset_us)]
    right_side = summary.wired("right")
    return {
        "header": header,
        "simulated": "sim" in header.cameras.split("?")[0].split(":"),
        "verdict": verdict(summary),
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
        "counted": len(counted(series.trigger, summary.camera("left").inliers["orb"])),
        "warm_up": WARM_UP_PAIRS,
        "blind_below": BLIND_BELOW["orb"],
        "moments": shown,
        "most_lines": MOST_LINES,
        "thinned": any(p.inliers > MOST_LINES for m in shown for p in (m.left, m.right)),
        "scatter": scatter(summary),
        "frames": len(series),
        "pairs_complete": summary.pairs_complete,
        "drops": summary.drops,
        "incomplete": drawn["incomplete"],
        "offset_us": {
            "median": spread(offsets)[1],
            "furthest": float(offsets[np.argmax(np.abs(offsets))]) if offsets.size else None,
        },
        "series": drawn,
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
