"""How numbers and names are written on the page."""

from __future__ import annotations

import math

from markupsafe import Markup

THIN_SPACE = "\u202f"
DASH = "–"

FRONT_END_NAMES = {"orb": "ORB", "viso2": "viso2-style"}
"""Front ends as people call them, by their name in summary.json."""


def number(value: float | None, places: int | None = None) -> str:
    """Return a number with thin spaces between thousands; None and NaN are a dash.

    `places` are decimals; None shows one only where there is a fraction.
    """
    if value is None or math.isnan(value):
        return DASH
    if places is None:
        places = 0 if value == int(value) else 1
    return f"{value:,.{places}f}".replace(",", THIN_SPACE).replace("-", "\u2212")


def data(value: float | None, places: int | None = None) -> Markup:
    """Return a number as `<data>`: exact in its value, rounded in its text."""
    if number(value, places) == DASH:
        return Markup("<span>{}</span>").format(DASH)
    return Markup('<data value="{}">{}</data>').format(repr(value), number(value, places))
