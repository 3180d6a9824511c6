"""Figures as SVG that any browser shows: panels of curves or of bars under one legend."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Protocol

WIDTH_PX, HEIGHT_PX = 420, 280
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 58, 12, 30, 40
LINE_PX = 18
COLOURS = (
    "#1f77b4",
    "#d62728",
    "#2ca02c",
    "#9467bd",
    "#8c564b",
    "#e377c2",
    "#7f7f7f",
    "#bcbd22",
    "#ff7f0e",
    "#17becf",
)
TICKS = 5
MOST_DOTS = 100
"""A line of more points is drawn without dots."""

Colours = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Scale:
    """Maps values from `low` to `high` onto 0..1.

    A logarithmic one needs low > 0; what lies below has no place there and is put at its end.
    """

    low: float
    high: float
    log: bool = False

    def share(self, value: float) -> float:
        """Return where a value lies."""
        low, high, value = (self._bent(each) for each in (self.low, self.high, value))
        return (value - low) / (high - low) if high > low else 0.5

    def ticks(self) -> list[float]:
        """Return round values between the ends."""
        return self._decades() if self.log else self._steps()

    def _decades(self) -> list[float]:
        first, last = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
        every = 1 + (last - first) // (2 * TICKS)
        digits = (1, 2, 5) if self.high <= 1_000 * self.low else (1,)
        steps = [d * 10.0**decade for decade in range(first, last + 1, every) for d in digits]
        return [step for step in steps if self.low <= step <= self.high]

    def _steps(self) -> list[float]:
        raw = (self.high - self.low) / TICKS or 1.0
        power = 10.0 ** math.floor(math.log10(raw))
        step = next(digit * power for digit in (1, 2, 5, 10) if digit * power >= raw * (1 - 1e-9))
        first, last = math.ceil(self.low / step), math.floor(self.high / step)
        return [step * number for number in range(first, last + 1)]

    def _bent(self, value: float) -> float:
        return math.log(max(value, self.low)) if self.log else value


@dataclass(frozen=True, slots=True)
class Curve:
    """Points joined by a line, or loose; each says its value when pointed at, or its `words`."""

    name: str
    x: Sequence[float]
    y: Sequence[float]
    joined: bool = True
    words: Sequence[str] = ()


class Panel(Protocol):
    """One frame of a figure."""

    @property
    def names(self) -> Sequence[str]:
        """Return what the legend names."""
        ...

    def draw(self, colours: Colours) -> Iterator[str]:
        """Yield the SVG of a frame of WIDTH_PX x HEIGHT_PX."""
        ...


@dataclass(frozen=True, slots=True)
class Curves:
    """A panel of curves; `across` and `up` name the axes."""

    title: str
    curves: Sequence[Curve]
    across: str
    up: str
    log_across: bool = False
    log_up: bool = False

    @property
    def names(self) -> Sequence[str]:
        """Return the names of the curves."""
        return [curve.name for curve in self.curves]

    def draw(self, colours: Colours) -> Iterator[str]:
        """Yield the frame, then each curve with its points."""
        x = _around([v for curve in self.curves for v in curve.x], self.log_across)
        y = _around([v for curve in self.curves for v in curve.y], self.log_up)
        yield from _frame(self.title, self.up, y)
        for tick in x.ticks():
            yield _text(_x(x.share(tick)), HEIGHT_PX - BOTTOM_PX + 16, f"{tick:g}", "middle")
        yield _text((LEFT_PX + WIDTH_PX - RIGHT_PX) / 2, HEIGHT_PX - 6, self.across, "middle")
        for curve in self.curves:
            points = [
                (_x(x.share(a)), _y(y.share(b))) for a, b in zip(curve.x, curve.y, strict=True)
            ]
            if curve.joined:
                joined = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
                yield f'<polyline points="{joined}" fill="none" stroke="{colours[curve.name]}"/>'
            if not curve.joined or len(points) <= MOST_DOTS:
                for (a, b), words in zip(points, _said(curve), strict=True):
                    yield _dot(a, b, colours[curve.name], words)


@dataclass(frozen=True, slots=True)
class Bars:
    """A panel of bars from 0; a bar is the mean of its values, which are dots upon it."""

    title: str
    bars: Mapping[str, Sequence[float]]

    @property
    def names(self) -> Sequence[str]:
        """Return the names of the bars."""
        return list(self.bars)

    def draw(self, colours: Colours) -> Iterator[str]:
        """Yield the frame, then each bar with its mean written below."""
        top = max((value for values in self.bars.values() for value in values), default=0.0)
        y = Scale(0.0, 1.08 * top or 1.0)
        yield from _frame(self.title, "", y)
        width = (WIDTH_PX - LEFT_PX - RIGHT_PX) / max(len(self.bars), 1)
        for number, (name, values) in enumerate(self.bars.items()):
            if not values:
                continue
            mean = sum(values) / len(values)
            middle, height = LEFT_PX + (number + 0.5) * width, _y(y.share(mean))
            yield (
                f'<rect x="{middle - 0.35 * width:.1f}" y="{height:.1f}" width="{0.7 * width:.1f}" '
                f'height="{_y(0) - height:.1f}" fill="{colours[name]}" fill-opacity="0.35"/>'
            )
            for value in values:
                yield _dot(middle, _y(y.share(value)), colours[name], f"{name}: {value:.4g}")
            yield _text(middle, HEIGHT_PX - BOTTOM_PX + 16, f"{mean:.4g}", "middle")


def svg(panels: Sequence[Panel], columns: int = 2) -> str:
    """Return an SVG of panels in rows, with one legend for all above them."""
    names = list(dict.fromkeys(name for panel in panels for name in panel.names))
    colours = {name: COLOURS[number % len(COLOURS)] for number, name in enumerate(names)}
    columns = min(columns, len(panels))
    legend_px = LINE_PX * len(names) + 8
    width_px = columns * WIDTH_PX
    height_px = legend_px + math.ceil(len(panels) / columns) * HEIGHT_PX
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width_px} {height_px}" '
        f'width="{width_px}" height="{height_px}" font-family="sans-serif" font-size="12">',
        f'<rect width="{width_px}" height="{height_px}" fill="white"/>',
    ]
    for number, name in enumerate(names):
        at = 14 + LINE_PX * number
        lines.append(
            f'<rect x="{LEFT_PX}" y="{at - 9}" width="10" height="10" fill="{colours[name]}"/>'
        )
        lines.append(_text(LEFT_PX + 16, at, name, "start"))
    for number, panel in enumerate(panels):
        x, y = (number % columns) * WIDTH_PX, legend_px + (number // columns) * HEIGHT_PX
        lines += [f'<g transform="translate({x} {y})">', *panel.draw(colours), "</g>"]
    return "\n".join([*lines, "</svg>", ""])


def _said(curve: Curve) -> Sequence[str]:
    if curve.words:
        return curve.words
    return [f"{curve.name}, {a:g}: {b:.4g}" for a, b in zip(curve.x, curve.y, strict=True)]


def _around(values: Sequence[float], log: bool) -> Scale:
    """Return a scale that holds all values; on a logarithmic one, those above 0."""
    kept = [value for value in values if not log or value > 0]
    if not kept:
        return Scale(1.0, 10.0, log)
    low, high = min(kept), max(kept)
    if log:
        return Scale(low / 1.05, high * 1.05, log)
    room = 0.04 * (high - low) or 0.5
    return Scale(low - room, high + room)


def _frame(title: str, up: str, y: Scale) -> Iterator[str]:
    yield _text(LEFT_PX, TOP_PX - 10, title, "start")
    yield (
        f'<rect x="{LEFT_PX}" y="{TOP_PX}" width="{WIDTH_PX - LEFT_PX - RIGHT_PX}" '
        f'height="{HEIGHT_PX - TOP_PX - BOTTOM_PX}" fill="none" stroke="#999"/>'
    )
    for tick in y.ticks():
        at = _y(y.share(tick))
        yield (
            f'<line x1="{LEFT_PX}" x2="{WIDTH_PX - RIGHT_PX}" y1="{at:.1f}" y2="{at:.1f}" '
            'stroke="#ddd"/>'
        )
        yield _text(LEFT_PX - 5, at + 4, f"{tick:g}", "end")
    if up:
        middle = (TOP_PX + HEIGHT_PX - BOTTOM_PX) / 2
        yield (
            f'<text transform="translate(13 {middle:.1f}) rotate(-90)" text-anchor="middle">'
            f"{escape(up)}</text>"
        )


def _x(share: float) -> float:
    return LEFT_PX + share * (WIDTH_PX - LEFT_PX - RIGHT_PX)


def _y(share: float) -> float:
    return HEIGHT_PX - BOTTOM_PX - share * (HEIGHT_PX - TOP_PX - BOTTOM_PX)


def _text(x: float, y: float, words: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>'


def _dot(x: float, y: float, colour: str, told: str) -> str:
    return (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.2" fill="{colour}">'
        f"<title>{escape(told)}</title></circle>"
    )
