"""Values refuse what they cannot mean."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.core.clock import VirtualClock
from rig.core.types import THESIS_LIMITS, Limits, Settings
from rig.core.units import gain_db, gain_factor

FINITE_US = st.floats(1e-3, 1e9)
FINITE_DB = st.floats(0, 1e3)


@pytest.mark.parametrize("exposure_us", [0.0, -1.0, math.nan, math.inf])
def test_settings_refuse_an_exposure_that_is_none(exposure_us: float) -> None:
    with pytest.raises(ValueError, match="exposure_us"):
        Settings(exposure_us, 0.0)


@pytest.mark.parametrize("db", [-0.1, math.nan, math.inf])
def test_settings_refuse_a_gain_that_is_none(db: float) -> None:
    with pytest.raises(ValueError, match="gain_db"):
        Settings(100.0, db)


def test_limits_refuse_a_range_that_runs_back() -> None:
    with pytest.raises(ValueError, match="ordered"):
        Limits((100.0, 10.0), (0.0, 1.0))


@given(FINITE_US, FINITE_DB)
def test_clamping_lands_inside_and_is_idempotent(exposure_us: float, db: float) -> None:
    once = Settings(exposure_us, db).clamp(THESIS_LIMITS)
    assert 75.0 <= once.exposure_us <= 30_000.0
    assert 0.0 <= once.gain_db <= 30.0
    assert once.clamp(THESIS_LIMITS) == once


def test_limits_overlap_or_say_that_they_do_not() -> None:
    camera = Limits((11.0, 30_000_000.0), (0.0, 24.0))
    assert camera.within(THESIS_LIMITS) == Limits((75.0, 30_000.0), (0.0, 24.0))
    with pytest.raises(ValueError, match="exposure_us"):
        Limits((1.0, 2.0), (0.0, 1.0)).within(THESIS_LIMITS)


def test_twenty_db_is_tenfold() -> None:
    assert gain_factor(20.0) == pytest.approx(10.0)
    assert gain_db(10.0) == pytest.approx(20.0)


def test_virtual_time_moves_only_forward() -> None:
    clock = VirtualClock()
    clock.sleep_s(-1.0)
    clock.sleep_s(0.25)
    clock.advance_to_ns(100)
    assert clock.now_ns() == 250_000_000
