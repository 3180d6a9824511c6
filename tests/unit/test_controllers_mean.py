"""The classical mean-intensity control."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.controllers.mean import STEEPEST, MeanController
from rig.core.types import THESIS_LIMITS, Frame, Settings
from rig.core.units import gain_factor


def frame(mean_dn: int, used: Settings) -> Frame:
    return Frame(np.full((4, 4), mean_dn, np.uint8), "bayer_rggb8", 0, 0, 0, used)


def brightness_us(settings: Settings) -> float:
    return settings.exposure_us * gain_factor(settings.gain_db)


def asked(controller: MeanController, mean_dn: int, used: Settings) -> Settings:
    controller.reset(THESIS_LIMITS)
    command = controller.step(frame(mean_dn, used))
    assert isinstance(command, Settings)
    return command


def test_one_step_reaches_the_target() -> None:
    used = Settings(2_000.0, 0.0)
    assert asked(MeanController(percent=50, exposure_us_max=30_000.0), 51, used) == Settings(
        5_000.0, 0.0
    )


def test_gain_makes_up_for_a_capped_exposure() -> None:
    command = asked(MeanController(exposure_us_max=4_000.0), 51, Settings(3_000.0, 0.0))
    assert command.exposure_us == 4_000.0
    assert brightness_us(command) == pytest.approx(7_500.0)


@pytest.mark.parametrize(("mean_dn", "factor"), [(0, STEEPEST), (255, 0.5)])
def test_black_and_white_pictures_give_bounded_steps(mean_dn: int, factor: float) -> None:
    command = asked(MeanController(), mean_dn, Settings(1_000.0, 0.0))
    assert brightness_us(command) == pytest.approx(1_000.0 * factor)


def test_half_speed_takes_the_root_of_the_correction() -> None:
    command = asked(
        MeanController(percent=80, speed=0.5, exposure_us_max=8_000.0), 51, Settings(1_000.0, 0.0)
    )
    assert command.exposure_us == pytest.approx(2_000.0)


OFF_TARGET = st.integers(0, 255).filter(lambda mean_dn: abs(mean_dn - 127.5) > 3)


@given(OFF_TARGET, st.floats(75, 30_000), st.floats(0, 30))
def test_gain_rises_only_above_the_cap(mean_dn: int, exposure_us: float, db: float) -> None:
    command = asked(MeanController(exposure_us_max=8_000.0), mean_dn, Settings(exposure_us, db))
    assert command.gain_db == 0.0 or command.exposure_us == 8_000.0


@pytest.mark.parametrize("options", [{"percent": 0}, {"speed": 2}, {"exposure_us_max": 0}])
def test_options_out_of_range_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        MeanController(**options)
