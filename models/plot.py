"""A training's losses as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rig.plot import Curve, Curves, svg

_SMALLEST = 1e-9
"""A loss of 0 has no place on a logarithmic axis."""


def write_losses(path: Path, curves: Mapping[str, Sequence[float]], over: str) -> None:
    """Write an SVG of losses by name, after 1, 2, ... of `over`; the legend tells the last."""
    drawn = [
        Curve(
            f"{name}: {losses[-1]:.4g}",
            range(1, len(losses) + 1),
            [max(loss, _SMALLEST) for loss in losses],
        )
        for name, losses in curves.items()
    ]
    path.write_text(svg([Curves("Loss", drawn, over, "loss", log_up=True)]), encoding="utf-8")
