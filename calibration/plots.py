"""What a calibration looks like, as SVG: residuals, histograms, response curves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig.calibration.intrinsics import RigFit
from rig.core.types import SIDES, Pair
from rig.plot import Curve, Curves, svg

Column = NDArray[np.float64]


def residual_plot(fit: RigFit) -> str:
    """Return the residual of every view of both cameras; dropped views say why when pointed at."""
    triggers = [view.trigger for view in fit.kept]
    kept = [
        Curve(side, triggers, [float(px) for px in camera.view_px], joined=False)
        for side, camera in zip(SIDES, fit.cameras, strict=True)
    ]
    dropped = Curve(
        "dropped",
        [view.trigger for view in fit.dropped],
        [view.residual_px for view in fit.dropped],
        joined=False,
        words=[f"pair {view.trigger} dropped: {view.reason}" for view in fit.dropped],
    )
    return svg([Curves("Residual of each view", [*kept, dropped], "pair", "px")])


def histogram_plot(pictures: Pair[Column], title: str) -> str:
    """Return the histograms of both cameras over 0..255; each column sums to 1."""
    return _both(pictures, np.arange(256.0), title, "grey value", "share")


def response_plot(curves: Pair[Column]) -> str:
    """Return the response curves of both cameras, grey values at even steps of light."""
    light = np.linspace(0.0, 1.0, len(curves.primary))
    return _both(curves, light, "Response", "light, 1 saturates", "grey value")


def _both(columns: Pair[Column], x: Column, title: str, across: str, up: str) -> str:
    curves = [
        Curve(side, x.tolist(), column.tolist())
        for side, column in zip(SIDES, columns, strict=True)
    ]
    return svg([Curves(title, curves, across, up)])
