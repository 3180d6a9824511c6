"""How numbers and names are written on the page."""

from __future__ import annotations

import math

from markupsafe import Markup

THIN_SPACE = "\u202f"
DASH = "–"

FRONT_END_NAMES = {"orb": "ORB", "viso2": "viso2-style"}
"""Front ends as people call them, by their name in summary.json."""


def labels(left: str, right: str) -> tuple[str, str]:
    """Return what to call two controllers: as short as tells them apart.

    >>> labels("ours", "fixed:exposure_us=700,gain_db=0")
    ('ours', 'fixed')
    >>> labels("aeag", "aeag")
    ('aeag (left)', 'aeag (right)')
    """
    if left == right:
        name = kind(left)
        return f"{name} (left)", f"{name} (right)"
    if kind(left) == kind(right):
        return left, right
    return kind(left), kind(right)


def failed(controller: str, pictures: int) -> str:
    """Return what is to be known of a controller that failed on so many pictures."""
    return (
        f"{controller} failed on {pictures} pictures, where its last settings held: "
        "this is no drive of its own"
    )


def kind(controller: str) -> str:
    """Return a controller's name without its options."""
    return controller.partition(":")[0]


def options(controller: str) -> str:
    """Return a controller's options without its name; empty when it has none."""
    return controller.partition(":")[2]


def number(value: float | None, places: int | None = None) -> str:
    """Return a number with thin spaces between thousands; None and NaN are a dash.

    `places` are decimals; None shows one only where there is a fraction.
    """
    if value is None or math.isnan(value):
        return DASH
    if places is None:
        places = 0 if value == int(value) else 1
    return f"{value:,.{places}f}".replace(",", THIN_SPACE).replace("-", "\u2212")


def significant(value: float | None) -> Markup:
    """Return a number as `<data>` with three significant digits, for what spans decades."""
    if value is None or math.isnan(value) or value <= 0:
        return data(value, 0)
    return data(value, max(2 - math.floor(math.log10(value)), 0))


def data(value: float | None, places: int | None = None) -> Markup:
    """Return a number as `<data>`: exact in its value, rounded in its text."""
    if number(value, places) == DASH:
        return Markup("<span>{}</span>").format(DASH)
    return Markup('<data value="{}">{}</data>').format(repr(value), number(value, places))
