"""The automatic exposure and gain law keeps the rules of a recorded camera trace."""

from __future__ import annotations

import math
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.core.autoexposure import AutoExposure, metered_dn, metered_part
from rig.core.types import THESIS_LIMITS, Auto, Limits, Metering, Priority, Settings
from rig.core.units import gain_factor

MEANS_DN = st.lists(st.floats(0, 255), min_size=1, max_size=60)
# Light levels that a target of 110 can be reached in: longest exposure with most gain at one
# end, shortest exposure without gain at the other.
DN_PER_US = st.floats(math.log(110 / 30_000 / 31), math.log(110 / 75)).map(math.exp)


@st.composite
def limits(draw: st.DrawFn) -> Limits:
    shortest_us = draw(st.floats(10, 1_000))
    lowest_db = draw(st.floats(0, 10))
    return Limits(
        (shortest_us, shortest_us * draw(st.floats(1, 1_000))),
        (lowest_db, lowest_db + draw(st.floats(0, 40))),
    )


STARTS = st.builds(Settings, st.floats(75, 30_000), st.just(0.0)) | st.builds(
    Settings, st.just(30_000.0), st.floats(0, 30)
)


def mean_dn(state: AutoExposure, dn_per_us: float) -> float:
    """Return the mean of a linear camera that saturates."""
    brightness = state.settings.exposure_us * gain_factor(state.settings.gain_db)
    return min(255.0, dn_per_us * brightness)


def run(state: AutoExposure, dn_per_us: float, frames: int) -> AutoExposure:
    for _ in range(frames):
        state = state.after(mean_dn(state, dn_per_us))
    return state


@given(limits(), st.floats(1, 255), st.floats(0, 0.95), MEANS_DN, st.floats(1, 1e5))
def test_every_step_is_bounded_and_inside_the_limits(
    bounds: Limits, target_dn: float, damping: float, means_dn: list[float], start_us: float
) -> None:
    state = AutoExposure(bounds, target_dn, damping, Settings(start_us, 5.0))
    for mean in means_dn:
        old, state = state.settings, state.after(mean)
        new = state.settings
        assert new == new.clamp(bounds)
        assert 0.885 * (1 - 1e-9) <= new.exposure_us / old.exposure_us <= 1.421 * (1 + 1e-9)
        assert abs(new.gain_db - old.gain_db) <= 1.2 + 1e-9


@given(STARTS, st.floats(0, 0.95), MEANS_DN)
def test_gain_is_last_up_and_first_down(
    start: Settings, damping: float, means_dn: list[float]
) -> None:
    state = AutoExposure(THESIS_LIMITS, 110.0, damping, start)
    for mean in means_dn:
        old, state = state.settings, state.after(mean)
        new = state.settings
        if new.gain_db > 0:
            assert new.exposure_us >= 0.97 * THESIS_LIMITS.exposure_us[1]
        if new.exposure_us < old.exposure_us:
            assert new.gain_db == 0


@given(st.floats(75, 5_000), st.floats(0, 0.95), MEANS_DN)
def test_under_exposure_priority_exposure_is_last_up_and_first_down(
    start_us: float, damping: float, means_dn: list[float]
) -> None:
    state = AutoExposure(THESIS_LIMITS, 110.0, damping, Settings(start_us, 0.0), "exposure")
    for mean in means_dn:
        old, state = state.settings, state.after(mean)
        new = state.settings
        if new.exposure_us > 5_000:
            assert new.gain_db == THESIS_LIMITS.gain_db[1]
        if new.exposure_us < 5_000:
            assert new.gain_db == 0
        if new.gain_db < old.gain_db:
            assert old.exposure_us == pytest.approx(5_000)


@given(STARTS, MEANS_DN)
def test_a_dark_frame_never_darkens_and_a_bright_one_never_brightens(
    start: Settings, means_dn: list[float]
) -> None:
    state = AutoExposure(THESIS_LIMITS, 110.0, 0.5, start)
    for mean in means_dn:
        before, state = mean_dn(state, 1e-9), state.after(mean)
        change = mean_dn(state, 1e-9) / before
        assert change >= 1 - 1e-9 if mean < 110 else change <= 1 + 1e-9


@settings(deadline=None)
@given(STARTS, DN_PER_US, st.floats(0, 0.8), st.sampled_from(get_args(Priority)))
def test_it_reaches_the_target_from_anywhere_and_holds(
    start: Settings, dn_per_us: float, damping: float, priority: Priority
) -> None:
    state = run(AutoExposure(THESIS_LIMITS, 110.0, damping, start, priority), dn_per_us, 250)
    assert mean_dn(state, dn_per_us) == pytest.approx(110.0, rel=0.031)
    assert run(state, dn_per_us, 5) == state


@given(st.floats(0, 30), st.floats(75, 20_000))
def test_a_start_with_needless_gain_trades_it_for_exposure(gain_db: float, start_us: float) -> None:
    dn_per_us = 110 / 10_000
    state = run(
        AutoExposure(THESIS_LIMITS, 110.0, 0.5, Settings(start_us, gain_db)), dn_per_us, 120
    )
    assert state.settings.gain_db == 0
    assert mean_dn(state, dn_per_us) == pytest.approx(110.0, rel=0.031)


def test_it_recovers_from_black_and_from_white() -> None:
    state = AutoExposure(THESIS_LIMITS, 110.0, 0.5, Settings(1_000.0, 0.0))
    for _ in range(100):
        state = state.after(0.0)
    assert state.settings == Settings(30_000.0, 30.0)
    for _ in range(150):
        state = state.after(255.0)
    assert state.settings == Settings(75.0, 0.0)
    assert mean_dn(run(state, 0.05, 60), 0.05) == pytest.approx(110.0, rel=0.031)


def test_more_damping_takes_smaller_steps() -> None:
    steps = [
        AutoExposure(THESIS_LIMITS, 110.0, damping, Settings(1_000.0, 0.0)).after(100.0).settings
        for damping in (0.0, 0.5, 0.9)
    ]
    assert [step.exposure_us for step in steps] == pytest.approx(
        [1_100.0, 1_000 * 1.1**0.5, 1_000 * 1.1**0.1]
    )


@pytest.mark.parametrize("mean", [-1.0, 256.0, math.nan])
def test_a_mean_outside_the_picture_is_refused(mean: float) -> None:
    with pytest.raises(ValueError, match="mean_dn"):
        AutoExposure(THESIS_LIMITS, 110.0, 0.5, Settings(1_000.0, 0.0)).after(mean)


@pytest.mark.parametrize(
    ("metering", "share"), [("average", 1.0), ("lower", 0.7), ("partial", 0.11), ("spot", 0.03)]
)
@pytest.mark.parametrize("shape", [(1536, 2048), (480, 640)])
def test_metering_looks_at_its_share_of_the_picture_and_at_every_colour_alike(
    shape: tuple[int, int], metering: Metering, share: float
) -> None:
    rows, columns = metered_part(shape, metering)
    looked_at = np.zeros(shape, np.uint8)
    looked_at[rows, columns] = 255
    assert looked_at.mean() / 255 == pytest.approx(share, rel=0.03)
    colours = [looked_at[y::2, x::2].mean() for y in (0, 1) for x in (0, 1)]
    assert colours == [colours[0]] * 4
    assert metered_dn(looked_at, metering) == 255


@pytest.mark.parametrize("options", [{"metering": "matrix"}, {"priority": "iris"}])
def test_words_that_no_camera_knows_are_refused(options: dict[str, str]) -> None:
    with pytest.raises(ValueError, match="must be one of"):
        Auto(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize(("target_dn", "damping"), [(0.0, 0.5), (256.0, 0.5), (110.0, 1.0)])
def test_bad_options_are_refused(target_dn: float, damping: float) -> None:
    with pytest.raises(ValueError, match="must be in"):
        AutoExposure(THESIS_LIMITS, target_dn, damping, Settings(1_000.0, 0.0))
