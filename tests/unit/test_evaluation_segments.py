"""Tunnels are found from the light alone, and nothing is found where there is none."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from synthetic_run import SyntheticRun

from rig.evaluation.front_ends import parse_front_ends
from rig.evaluation.segments import KINDS, Segment, kinds_by_row, light_level, segments
from rig.evaluation.series import measure


def tunnel(bright_after: float = 9_000.0) -> NDArray[np.float64]:
    """Return a drive: 20 pairs outside, 10 darkening, 30 inside, 8 brightening, 20 outside."""
    return np.concatenate(
        [
            np.full(20, 3_000.0),
            np.geomspace(3_000, 250, 10),
            np.full(30, 250.0),
            np.geomspace(250, bright_after, 8),
            np.full(20, bright_after),
        ]
    )


def kinds(found: list[Segment]) -> list[str]:
    return [segment.kind for segment in found]


def test_a_tunnel_has_its_five_parts_where_the_light_changes() -> None:
    found = segments(tunnel())
    assert kinds(found) == ["static", "approaching", "inside", "leaving", "static"]
    borders = [segment.first for segment in found[1:]]
    assert borders == pytest.approx([22, 28, 62, 67], abs=2)


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e4])
def test_the_unit_of_light_does_not_matter(factor: float) -> None:
    assert segments(tunnel() * factor) == segments(tunnel())


def test_a_drive_back_in_time_approaches_what_it_left() -> None:
    assert kinds(segments(tunnel(3_000.0)[::-1])) == kinds(segments(tunnel(3_000.0)))


def test_steady_light_is_static() -> None:
    rng = np.random.default_rng(0)
    assert segments(1_000 * rng.uniform(0.7, 1.3, 80)) == [Segment("static", 0, 79)]
    assert segments(np.full(3, 5.0)) == [Segment("static", 0, 2)]
    assert segments(np.empty(0)) == []


def test_a_bridge_of_three_pairs_and_a_flicker_are_no_tunnel() -> None:
    light = tunnel()
    light[8:11] = 200.0
    light[40] = 9_000.0
    assert kinds(segments(light)) == ["static", "approaching", "inside", "leaving", "static"]


def test_two_tunnels_are_two() -> None:
    found = segments(np.concatenate([tunnel(3_000.0), tunnel(3_000.0)]))
    assert kinds(found) == [*["static", "approaching", "inside", "leaving"] * 2, "static"]


def test_a_drive_may_begin_inside() -> None:
    assert kinds(segments(tunnel()[35:])) == ["inside", "leaving", "static"]


def test_gaps_in_the_light_are_bridged() -> None:
    light = tunnel()
    light[[0, 25, 45, 87]] = np.nan
    assert kinds(segments(light)) == kinds(segments(tunnel()))
    assert segments(np.full(6, np.nan)) == [Segment("static", 0, 5)]


@settings(deadline=None)
@given(st.lists(st.floats(0, 1e5) | st.just(float("nan")), max_size=60))
@example([0.0, 0.0, 0.0, 2e4, 0.0, np.nan, 2e-58, 6e4, np.nan, 4e-25, 3e4, 6e4, 7e4])
def test_every_row_is_in_one_segment(light: list[float]) -> None:
    found = segments(np.array(light))
    rows = [row for segment in found for row in range(segment.first, segment.last + 1)]
    assert rows == list(range(len(light)))
    assert all(a.kind != b.kind for a, b in pairwise(found))
    by_row = kinds_by_row(found, len(light))
    assert len(by_row) == len(light)
    assert set(by_row) <= set(KINDS)


def test_pictures_tell_the_light_where_nobody_else_does() -> None:
    series = measure(SyntheticRun(triggers=60).records(), parse_front_ends("orb"))
    real = replace(series, light_cd_m2=np.full(60, np.nan))
    true, told = (
        next(part for part in segments(light_level(run)) if part.kind == "inside")
        for run in (series, real)
    )
    assert told.first == pytest.approx(true.first, abs=6)
    assert told.last == pytest.approx(true.last, abs=6)
