"""Commands become settings: steps, limits, delay and the camera's own law."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.config import load_camera_model
from rig.core.types import Auto, Limits, Metering, Settings
from rig.drivers.simulated.program import ExposureProgram, round_command, round_settings

CONTROLS = load_camera_model("blackfly-s-u3-31s4").controls
DARK = np.full((4, 4), 10, np.uint8)


@pytest.mark.parametrize(
    ("asked", "rounded"),
    [
        (Settings(100.4, 0.04), Settings(100.0, 0.0)),
        (Settings(100.6, 0.26), Settings(101.0, 0.3)),
        (Settings(1.0, 0.0), Settings(11.0, 0.0)),
        (Settings(1e9, 47.99), Settings(30e6, 47.9)),
    ],
)
def test_settings_go_to_the_steps_of_the_camera(asked: Settings, rounded: Settings) -> None:
    assert round_command(asked, CONTROLS) == rounded


@given(
    exposure_us=st.floats(1e-3, 1e9),
    gain_db=st.floats(0.0, 100.0),
)
def test_rounded_settings_are_inside_the_limits_and_stay_put(
    exposure_us: float, gain_db: float
) -> None:
    limits = Limits((75.0, 30_000.0), (0.0, 30.0))
    once = round_settings(Settings(exposure_us, gain_db), limits, CONTROLS)
    assert once == once.clamp(limits)
    assert round_settings(once, limits, CONTROLS) == once


def test_auto_limits_are_moved_into_those_of_the_camera() -> None:
    auto = Auto(Limits((1.0, 60e6), (0.0, 90.0)), start=Settings(5.0, 80.0))
    rounded = round_command(auto, CONTROLS)
    assert isinstance(rounded, Auto)
    assert rounded.limits == CONTROLS.limits
    assert rounded.start == Settings(11.0, 47.9)


def test_before_any_command_the_camera_has_its_initial_settings() -> None:
    program = ExposureProgram(CONTROLS, latency_frames=2)
    program.ask(Settings(700.0, 3.0))
    initial = Settings(CONTROLS.initial_exposure_us, CONTROLS.initial_gain_db)
    assert [program.next_exposure() for _ in range(4)] == [
        initial,
        initial,
        Settings(700.0, 3.0),
        Settings(700.0, 3.0),
    ]


def test_the_own_law_keeps_its_state_while_the_command_stays_equal() -> None:
    program = ExposureProgram(CONTROLS, latency_frames=0)
    exposures_us = []
    for _ in range(4):
        program.ask(Auto(start=Settings(100.0, 0.0)))
        exposures_us.append(program.next_exposure().exposure_us)
        program.saw(DARK)
    assert exposures_us == sorted(set(exposures_us))
    program.ask(Auto(target_dn=90.0, start=Settings(100.0, 0.0)))
    assert program.next_exposure() == Settings(100.0, 0.0)


def test_the_own_law_rests_while_settings_are_given() -> None:
    program = ExposureProgram(CONTROLS, latency_frames=0)
    used = []
    for command in (Settings(500.0, 0.0), Auto(start=Settings(100.0, 0.0)), Settings(500.0, 0.0)):
        program.ask(command)
        for _ in range(2):
            used.append(program.next_exposure().exposure_us)
            program.saw(DARK)
    assert used == [500, 500, 100, 142, 500, 500]


@pytest.mark.parametrize(("metering", "brightens"), [("average", False), ("lower", True)])
def test_the_own_law_looks_at_the_part_that_counts(metering: Metering, brightens: bool) -> None:
    image = np.zeros((100, 100), np.uint8)
    image[:30] = 255
    program = ExposureProgram(CONTROLS, latency_frames=0)
    program.ask(Auto(target_dn=70, start=Settings(1_000.0, 0.0), metering=metering))
    program.next_exposure()
    program.saw(image)
    assert (program.next_exposure().exposure_us > 1_000) == brightens
