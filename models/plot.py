"""A training's losses as a picture: one SVG that any browser shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

WIDTH_PX, HEIGHT_PX, MARGIN_PX = 640, 360, 56
COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f", "#bcbd22")


def write_losses(path: Path, curves: Sequence[tuple[str, Sequence[float]]], over: str) -> None:
    """Write curves of (name, loss after 1, 2, ... of `over`); the scale is logarithmic."""
    curves = [(name, [max(loss, 1e-9) for loss in losses]) for name, losses in curves]
    values = [value for _, losses in curves for value in losses]
    low, high = math.log(min(values) * 0.9), math.log(max(values) * 1.1)
    longest = max(2, *(len(losses) for _, losses in curves))

    def place(index: int, loss: float) -> str:
        x = MARGIN_PX + index * (WIDTH_PX - 2 * MARGIN_PX) / (longest - 1)
        share = (math.log(loss) - low) / (high - low)
        return f"{x:.1f},{HEIGHT_PX - MARGIN_PX - share * (HEIGHT_PX - 2 * MARGIN_PX):.1f}"

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH_PX} {HEIGHT_PX}" '
        'font-family="sans-serif" font-size="13">',
        f'<rect width="{WIDTH_PX}" height="{HEIGHT_PX}" fill="white"/>',
        f'<text x="{WIDTH_PX / 2}" y="{HEIGHT_PX - 16}" text-anchor="middle">{over}</text>',
    ]
    for number, (name, losses) in enumerate(curves):
        colour = COLOURS[number % len(COLOURS)]
        points = " ".join(place(index, loss) for index, loss in enumerate(losses))
        parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}"/>')
        for index, point in enumerate(points.split()):
            x, y = point.split(",")
            told = f"<title>{over} {index + 1}: {losses[index]:.4g}</title>"
            parts.append(f'<circle cx="{x}" cy="{y}" r="2.5" fill="{colour}">{told}</circle>')
        words = f"{name}: {losses[-1]:.4g}"
        parts.append(f'<text x="{MARGIN_PX}" y="{20 + 16 * number}" fill="{colour}">{words}</text>')
    path.write_text("\n".join([*parts, "</svg>", ""]), encoding="utf-8")
