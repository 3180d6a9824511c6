"""Small plots as SVG: they open in any browser and need no display to be made."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from rig.calibration.intrinsics import RigFit
from rig.core.types import Pair

_WIDTH, _HEIGHT = 760, 340
_LEFT, _RIGHT, _TOP, _BOTTOM = 56, 16, 44, 48
_PRIMARY, _SECONDARY, _DROPPED = "#1f6fb2", "#d9822b", "#b3261e"

Column = NDArray[np.float64]


def residual_plot(fit: RigFit) -> str:
    """Return the residual of every view of both cameras; dropped views are red, with the reason."""
    kept = {
        view.trigger: (float(a), float(b))
        for view, a, b in zip(
            fit.kept, fit.cameras.primary.view_px, fit.cameras.secondary.view_px, strict=True
        )
    }
    dropped = {view.trigger: view for view in fit.dropped}
    triggers = sorted(kept | dropped)
    top = 1.1 * max(
        [value for pair in kept.values() for value in pair] + [v.residual_px for v in fit.dropped]
    )
    step = (_WIDTH - _LEFT - _RIGHT) / len(triggers)
    bars: list[str] = []
    for place, trigger in enumerate(triggers):
        x = _LEFT + place * step
        if trigger in kept:
            for part, (value, colour) in enumerate(
                zip(kept[trigger], (_PRIMARY, _SECONDARY), strict=True)
            ):
                told = f"pair {trigger}: {value:.3f} px"
                bars.append(_bar(x + part * 0.45 * step, 0.4 * step, value / top, colour, told))
        else:
            view = dropped[trigger]
            told = f"pair {trigger} dropped: {view.reason}"
            bars.append(_bar(x, 0.85 * step, view.residual_px / top, _DROPPED, told))
    legend = (("primary", _PRIMARY), ("secondary", _SECONDARY), ("dropped", _DROPPED))
    return _page("Residual of each view", "pair", "px", top, "".join(bars), legend)


def histogram_plot(pictures: Pair[Column], title: str) -> str:
    """Return the histograms of both cameras over 0..255; each column sums to 1."""
    return _two_lines(pictures, title, "grey value 0 to 255", "share")


def response_plot(curves: Pair[Column]) -> str:
    """Return the response curves of both cameras, grey values at even steps of light."""
    return _two_lines(curves, "Response", "light, dark to saturation", "grey value")


def _two_lines(columns: Pair[Column], title: str, x: str, y: str) -> str:
    top = 1.1 * max(float(column.max()) for column in columns)
    wide, high = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    lines = []
    for column, colour in zip(columns, (_PRIMARY, _SECONDARY), strict=True):
        points = " ".join(
            f"{_LEFT + wide * place / (len(column) - 1):.1f},"
            f"{_TOP + high * (1 - float(value) / top):.1f}"
            for place, value in enumerate(column)
        )
        lines.append(f'<polyline points="{points}" fill="none" stroke="{colour}"/>')
    legend = (("primary", _PRIMARY), ("secondary", _SECONDARY))
    return _page(title, x, y, top, "".join(lines), legend)


def _bar(x: float, width: float, share: float, colour: str, told: str) -> str:
    high = (_HEIGHT - _TOP - _BOTTOM) * share
    return (
        f'<rect x="{x:.1f}" y="{_HEIGHT - _BOTTOM - high:.1f}" width="{width:.1f}" '
        f'height="{high:.1f}" fill="{colour}"><title>{escape(told)}</title></rect>'
    )


def _page(
    title: str, x: str, y: str, top: float, drawn: str, legend: Sequence[tuple[str, str]]
) -> str:
    base, right = _HEIGHT - _BOTTOM, _WIDTH - _RIGHT
    marks = "".join(
        f'<text x="{_LEFT - 6}" y="{base - (base - _TOP) * share + 4:.0f}" '
        f'text-anchor="end">{top * share:.2g}</text>'
        for share in (0.0, 0.5, 1.0)
    )
    names = "".join(
        f'<text x="{right - 90 * (len(legend) - k)}" y="24" fill="{colour}">{escape(name)}</text>'
        for k, (name, colour) in enumerate(legend)
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
        'font-family="sans-serif" font-size="12">'
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="white"/>'
        f'<text x="{_LEFT}" y="24" font-size="15">{escape(title)} ({escape(y)})</text>{names}'
        f'<path d="M{_LEFT} {_TOP}V{base}H{right}" fill="none" stroke="#888"/>{marks}'
        f'<text x="{(_LEFT + right) / 2:.0f}" y="{_HEIGHT - 12}" text-anchor="middle">'
        f"{escape(x)}</text>{drawn}</svg>\n"
    )
