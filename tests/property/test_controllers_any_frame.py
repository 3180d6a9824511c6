"""No sequence of frames, however odd, brings a controller outside its limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.controllers.registry import make_controller
from rig.core.types import Auto, Frame, Limits, Settings


@st.composite
def limits(draw: st.DrawFn) -> Limits:
    shortest_us, lowest_db = draw(st.floats(10, 30_000)), draw(st.floats(0, 20))
    return Limits(
        (shortest_us, shortest_us * draw(st.sampled_from([1.0, 1.5, 400.0]))),
        (lowest_db, lowest_db + draw(st.sampled_from([0.0, 1.0, 30.0]))),
    )


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    low, high = draw(st.sampled_from([(0, 1), (255, 256), (0, 256), (100, 110), (0, 2)]))
    image = rng.integers(low, high, (16, 20), dtype=np.uint8)
    image = np.repeat(np.repeat(image, 2, axis=0), 2, axis=1)
    used = Settings(draw(st.floats(1, 1e6)), draw(st.floats(0, 60)))
    return Frame(image, "bayer_rggb8", draw(st.integers(0, 99)), 0, 0, used)


@pytest.mark.parametrize(
    "spec",
    [
        "ae:exposure_us_max=1e9",
        "aeag:exposure_us_max=1e9",
        "geomean",
        "kim:evaluations_max=6",
        "lu",
        "mean",
        "shim",
        "shim:version=2018,gain=split",
        "shin:tolerance=0.001",
        "shin:variant=thesis",
        "zhang",
        "zhang:gain=split",
    ],
)
@settings(deadline=None, max_examples=25)
@given(bounds=limits(), sequence=st.lists(frames(), min_size=1, max_size=40))
def test_commands_stay_inside_any_limits(spec: str, bounds: Limits, sequence: list[Frame]) -> None:
    controller = make_controller(spec, seed=0, networks={}).controller
    commands = [controller.reset(bounds), *map(controller.step, sequence)]
    for command in commands:
        if isinstance(command, Auto):
            assert command.limits == command.limits.within(bounds)
        else:
            assert command == command.clamp(bounds)


@settings(deadline=None, max_examples=30)
@given(sequence=st.lists(frames(), min_size=1, max_size=30))
def test_what_was_seen_before_a_reset_is_forgotten(sequence: list[Frame]) -> None:
    controller = make_controller("shin", seed=0, networks={}).controller
    runs = []
    for _ in range(2):
        first = controller.reset(Limits())
        runs.append([first, *map(controller.step, sequence)])
    assert runs[0] == runs[1]
