"""Figures hold what they are given, in its place, and are valid XML."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from rig.plot import BOTTOM_PX, HEIGHT_PX, TOP_PX, Bars, Curve, Curves, Scale, svg

SVG = "{http://www.w3.org/2000/svg}"


def drawn(text: str) -> ElementTree.Element:
    return ElementTree.fromstring(text)


def said(root: ElementTree.Element) -> list[str]:
    return [element.text or "" for element in root.iter(f"{SVG}text")]


def test_curves_begin_at_the_left_and_end_at_the_right() -> None:
    curves = [Curve("a < b", (1, 2, 3), (10, 20, 30)), Curve("loose", (2,), (15,), joined=False)]
    root = drawn(svg([Curves("Title", curves, "across", "up")]))
    (line,) = root.iter(f"{SVG}polyline")
    (x0, y0), *_, (x1, y1) = [
        tuple(map(float, point.split(","))) for point in str(line.get("points")).split()
    ]
    assert x0 < x1 and HEIGHT_PX - BOTTOM_PX > y0 > y1 > TOP_PX
    dots = list(root.iter(f"{SVG}circle"))
    assert [dot.findtext(f"{SVG}title") for dot in dots][-1] == "loose, 2: 15"
    assert len(dots) == 4
    assert {"Title", "across", "up", "a < b", "loose"} <= set(said(root))


def test_a_bar_is_the_mean_of_its_dots() -> None:
    root = drawn(svg([Bars("Median", {"low": (100, 300), "high": (400,), "none": ()})]))
    assert {"200", "400"} <= set(said(root))
    low, high = (
        float(str(bar.get("height")))
        for bar in root.iter(f"{SVG}rect")
        if bar.get("fill-opacity") is not None
    )
    assert high == pytest.approx(2 * low, abs=0.2)
    assert len(list(root.iter(f"{SVG}circle"))) == 3


def test_panels_stand_in_rows_under_one_legend() -> None:
    panels = [Bars(title, {"one": (1,), "two": (2,)}) for title in "ABC"]
    root = drawn(svg(panels))
    places = [group.get("transform") for group in root.iter(f"{SVG}g")]
    assert len(set(places)) == 3
    assert said(root).count("one") == 1


def test_a_curve_without_points_is_named_and_takes_no_room() -> None:
    root = drawn(svg([Curves("Empty", [Curve("nothing", (), ())], "x", "y", log_up=True)]))
    assert "nothing" in said(root)


@pytest.mark.parametrize(
    ("scale", "ticks"),
    [
        (Scale(0, 10), [0, 2, 4, 6, 8, 10]),
        (Scale(0.9, 110, log=True), [1, 2, 5, 10, 20, 50, 100]),
        (Scale(-1, 1), [-1, -0.5, 0, 0.5, 1]),
    ],
)
def test_ticks_are_round(scale: Scale, ticks: list[float]) -> None:
    assert scale.ticks() == pytest.approx(ticks)
    assert scale.share(scale.low) == 0 and scale.share(scale.high) == 1
