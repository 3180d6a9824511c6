"""In the white and in the dark a score map's answer is overruled; nowhere else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from network_files import METADATA, SHAPES, linear
from numpy.typing import NDArray

from rig.controllers.network import NetworkController
from rig.controllers.reflex import startled
from rig.controllers.registry import make_controller
from rig.controllers.split import brightness_us
from rig.core.types import THESIS_LIMITS, Frame, Limits, Settings
from rig.evaluation.front_ends import FRONT_ENDS
from rig.experiments.solo import run_solo
from rig.models.shipped import shipped_networks

USED = Settings(2_000.0, 6.0)
SETTINGS = st.builds(Settings, st.floats(75.0, 30_000.0), st.floats(0.0, 30.0))
NARROW = Limits((100.0, 5_000.0), (0.0, 12.0))


def glance(mean: float, saturated: float = 0.0) -> NDArray[np.float32]:
    return np.stack([np.full((48, 64), share, np.float32) for share in (mean, saturated)])


def change_ev(used: Settings, command: Settings) -> float:
    return float(np.log2(brightness_us(command) / brightness_us(used)))


def test_after_a_white_picture_it_is_three_stops_darker_at_once() -> None:
    slow = Settings(1_500.0, 6.0)
    command = startled(glance(1.0, 0.97), USED, slow, THESIS_LIMITS)
    assert change_ev(USED, command) == pytest.approx(-3)
    bold = Settings(100.0, 0.0)
    assert startled(glance(1.0, 0.97), USED, bold, THESIS_LIMITS) is bold, "dark enough by itself"


def test_after_a_dark_picture_it_is_as_bright_as_it_has_to_be() -> None:
    slow = Settings(2_200.0, 6.0)
    command = startled(glance(0.47 / 4), USED, slow, THESIS_LIMITS)
    assert change_ev(USED, command) == pytest.approx(2, abs=1e-3)
    assert command.exposure_us > slow.exposure_us and command.gain_db > slow.gain_db
    black = startled(glance(0.0), USED, slow, THESIS_LIMITS)
    assert change_ev(USED, black) == pytest.approx(3)
    bold = Settings(20_000.0, 20.0)
    assert startled(glance(0.1), USED, bold, THESIS_LIMITS) is bold, "bright enough by itself"


@pytest.mark.parametrize("share", [0.0, 0.5, 0.94])
def test_where_something_can_be_seen_the_answer_stands(share: float) -> None:
    answer = Settings(1_900.0, 6.0)
    assert startled(glance(0.3 + 0.7 * share, share), USED, answer, THESIS_LIMITS) is answer


def test_a_dark_picture_with_a_lamp_in_it_is_left_to_the_network() -> None:
    """Inside a tunnel nearly everything is dark but the exit, which must not go white."""
    inside = glance(0.05)
    inside[0, 20:28, 28:42] = 1.0
    answer = Settings(2_200.0, 6.0)
    assert startled(inside, USED, answer, THESIS_LIMITS) is answer


@given(SETTINGS, SETTINGS, st.floats(0, 1), st.floats(0, 1))
def test_it_keeps_the_limits_and_never_turns_back(
    used: Settings, wanted: Settings, mean: float, saturated: float
) -> None:
    used, answer = used.clamp(NARROW), wanted.clamp(NARROW)
    command = startled(glance(mean, saturated), used, answer, NARROW)
    assert command == command.clamp(NARROW)
    turned_ev = change_ev(answer, command)
    assert turned_ev <= 1e-6 if saturated > 0.95 else turned_ev >= -1e-6


@pytest.mark.parametrize(("dn", "overruled"), [(255, True), (128, False), (8, True)])
def test_a_score_map_is_overruled_and_told_so(tmp_path: Path, dn: int, overruled: bool) -> None:
    path = linear(
        tmp_path / "slow.onnx",
        np.zeros((12, 2), np.float32),
        (0.1, 0.2),
        metadata=METADATA | {"picture": "thumbnail"},
        shapes=SHAPES | {"images": ["N", 6, 48, 64]},
    )
    controller = NetworkController(path)
    controller.reset(THESIS_LIMITS)
    answer = Settings(75 + 0.1 * 29_925, 6.0)
    seen = Frame(np.full((448, 448), dn, np.uint8), "bayer_rggb8", 0, 0, 0, answer)
    command = controller.step(seen)
    assert isinstance(command, Settings)
    assert (abs(change_ev(answer, command)) > 2) == overruled
    assert controller.diagnostics()["overruled"] == float(overruled)
    assert controller.reset(THESIS_LIMITS) == Settings(1_000.0, 0.0)
    assert controller.diagnostics()["overruled"] == 0.0


def test_the_thesis_network_is_left_as_it_is(tmp_path: Path) -> None:
    path = linear(tmp_path / "thesis.onnx", np.zeros((15, 2), np.float32), (0.1, 0.2))
    controller = NetworkController(path)
    controller.reset(THESIS_LIMITS)
    answer = Settings(75 + 0.1 * 29_925, 6.0)
    white = Frame(np.full((448, 448), 255, np.uint8), "bayer_rggb8", 0, 0, 0, answer)
    command = controller.step(white)
    assert isinstance(command, Settings)
    assert change_ev(answer, command) == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize("factor", ["10", "0.1"])
def test_ours_sees_again_in_the_third_pair_after_light_jumped(factor: str) -> None:
    ours = make_controller("ours", seed=0, networks=shipped_networks())
    address = f"sim:road?split=train&seed=9&size=640x480&light_step={factor}@12"
    done = run_solo(address, [ours], seed=9, frames=16, front_ends={"orb": FRONT_ENDS["orb"]})[0]
    before, jump, after = done.mean_dn[11], done.mean_dn[12], done.mean_dn[13]
    assert jump > 245 or jump < 0.2 * before
    assert 90 < after < 170
    assert done.inliers["orb"].blind_frames == 2
