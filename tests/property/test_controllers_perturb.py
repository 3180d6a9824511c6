"""Perturbed settings stray as far as the thesis lets them, and evenly (thesis 4.2.2)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.controllers.perturb import make_perturbation
from rig.core.errors import UsageError
from rig.core.types import THESIS_LIMITS, Frame, Limits, Settings

WIDE = Limits((1.0, 1e6), (0.0, 100.0))
SEEDS = st.integers(0, 2**32 - 1)
USED = st.builds(Settings, st.floats(75, 30_000), st.floats(0.01, 30))


def frame(used: Settings, value: int = 100) -> Frame:
    return Frame(np.full((4, 4), value, np.uint8), "mono8", 0, 0, 0, used)


def stray(name: str, seed: int, leaders: list[Frame], limits: Limits = WIDE) -> list[Settings]:
    perturbation = make_perturbation(name, seed=seed)
    perturbation.reset(limits)
    return [perturbation.near(leader) for leader in leaders]


@given(SEEDS, USED)
def test_the_cycle_visits_all_four_quadrants_in_four_frames(seed: int, used: Settings) -> None:
    settings = stray("cycle", seed, [frame(used)] * 8)
    quadrants = [
        (each.exposure_us >= used.exposure_us, each.gain_db >= used.gain_db) for each in settings
    ]
    assert len(set(quadrants[:4])) == 4
    assert quadrants[4:] == quadrants[:4]
    for each in settings:
        assert 0.5 <= each.exposure_us / used.exposure_us <= 1.5
        assert 0.5 - 1e-9 <= each.gain_db / used.gain_db <= 1.5 + 1e-9


@given(SEEDS, USED, st.integers(0, 255))
def test_intensity_moves_both_towards_the_middle(seed: int, used: Settings, value: int) -> None:
    for each in stray("intensity", seed, [frame(used, value)] * 4):
        for ratio in (each.exposure_us / used.exposure_us, each.gain_db / used.gain_db):
            assert 1 <= ratio <= 1.5 + 1e-9 if value <= 128 else 0.5 - 1e-9 <= ratio <= 1


@given(SEEDS, st.sampled_from(["cycle", "intensity"]), st.integers(0, 255))
def test_zero_gain_gets_a_small_or_a_large_addition(seed: int, name: str, value: int) -> None:
    for each in stray(name, seed, [frame(Settings(1_000.0, 0.0), value)] * 8):
        assert 0 <= each.gain_db <= 2 or 5 <= each.gain_db <= 10


def test_the_cycle_adds_small_and_large_gains_equally_often() -> None:
    settings = stray("cycle", 1, [frame(Settings(1_000.0, 0.0))] * 40)
    assert sum(each.gain_db >= 5 for each in settings) == 20


def test_the_stray_is_uniform() -> None:
    used = Settings(1_000.0, 10.0)
    settings = stray("cycle", 3, [frame(used)] * 4_000)
    ratios = np.array([(each.exposure_us / 1_000, each.gain_db / 10) for each in settings])
    for column in ratios.T:
        counts = np.histogram(column, bins=10, range=(0.5, 1.5))[0]
        assert counts.min() > 330
        assert counts.max() < 470
    assert abs(np.corrcoef(ratios.T)[0, 1]) < 0.05


@given(SEEDS, USED, st.sampled_from(["cycle", "intensity", "none"]))
def test_limits_hold_and_the_seed_decides(seed: int, used: Settings, name: str) -> None:
    leaders = [frame(used)] * 5
    settings = stray(name, seed, leaders, THESIS_LIMITS)
    assert settings == [each.clamp(THESIS_LIMITS) for each in settings]
    assert settings == stray(name, seed, leaders, THESIS_LIMITS)
    perturbation = make_perturbation(name, seed=seed)
    for _ in range(2):
        perturbation.reset(THESIS_LIMITS)
        assert [perturbation.near(leader) for leader in leaders] == settings


def test_another_seed_strays_elsewhere() -> None:
    leaders = [frame(Settings(1_000.0, 10.0))] * 4
    assert stray("cycle", 1, leaders) != stray("cycle", 2, leaders)


def test_none_copies() -> None:
    used = Settings(1_234.5, 6.7)
    assert stray("none", 0, [frame(used)]) == [used]


def test_an_unknown_perturbation_is_refused() -> None:
    with pytest.raises(UsageError, match="unknown perturbation 'cycl'; did you mean 'cycle'"):
        make_perturbation("cycl", seed=0)
