"""The response calibration's parts, and every way in which a bracket can go wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from rig.calibration.files import to_toml
from rig.calibration.response.bracket import FRAMES_EACH, Bracket
from rig.calibration.response.curve import Curve
from rig.calibration.response.debevec import debevec_curve
from rig.calibration.response.fit import fit_curve
from rig.calibration.response.photon_transfer import photon_transfer
from rig.calibration.response.step import Step, measurable, summarise_step
from rig.calibration.response.twin import make_twin
from rig.config import GammaResponse, LinearResponse, Response, SrgbResponse, TableResponse
from rig.core.errors import CalibrationError
from rig.core.types import Frame, Limits, Settings
from rig.core.units import gain_factor
from rig.drivers.sensor.sensor import response_curve

LIMITS = Limits((11.0, 1_000_000.0), (0.0, 30.0))
PER_E, READ_E, BLACK, E_PER_US = 1 / 10_500, 2.4, 0.0156, 0.1
LOGARITHM = tuple(float(np.log1p(3 * k / 64) / np.log(4)) for k in range(65))

Light = Callable[[int], float]


def steady(number: int) -> float:
    return 1.0


class Wall:
    """A camera before a blank surface: electrons, gain, black level, response, 8 bits."""

    def __init__(self, response: Response | None = None, light: Light = steady) -> None:
        self.response = response or LinearResponse()
        self.light = light
        self.number = 0
        self.rng = np.random.default_rng(7)
        self.tilt = np.ones((96, 128))
        self.obeys = True

    def shoot(self, settings: Settings) -> Frame:
        used = settings if self.obeys else Settings(5_000.0, 0.0)
        mean_e = self.light(self.number) * E_PER_US * used.exposure_us * self.tilt
        electrons = self.rng.poisson(mean_e) + self.rng.normal(0, READ_E, mean_e.shape)
        level = electrons * PER_E * gain_factor(used.gain_db) + BLACK
        grey = 255 * response_curve(self.response, np.clip(level, 0, 1))
        self.number += 1
        image = np.rint(grey).astype(np.uint8)
        return Frame(image, "bayer_rggb8", self.number, 0, 0, used)


def test_the_conversion_gain_is_that_at_0_db_of_a_camera_that_begins_above() -> None:
    twin = make_twin(bracketed(Wall(), Limits(LIMITS.exposure_us, (6.0, 30.0))), bits=12)
    assert twin.e_per_dn == pytest.approx(1 / PER_E / 4095, rel=0.03)
    assert [float(real) for real in twin.gains_db.values()] == pytest.approx(
        [float(stated) for stated in twin.gains_db], abs=0.1
    )


def bracketed(wall: Wall, limits: Limits = LIMITS) -> list[Step]:
    bracket = Bracket("primary", limits)
    for _ in range(600):
        bracket.see(wall.shoot(bracket.settings))
        if bracket.done:
            return bracket.steps
    raise AssertionError("the bracket never ended")


@pytest.fixture(scope="module")
def linear_steps() -> list[Step]:
    return bracketed(Wall())


@pytest.mark.parametrize(
    "response", [LinearResponse(), GammaResponse(gamma=2.0), SrgbResponse(), None]
)
def test_curve_and_noise_are_recovered(response: Response | None, linear_steps: list[Step]) -> None:
    """Of a camera whose curve is in no family (None), the black level is an extrapolation."""
    true = response or TableResponse(table=LOGARITHM)
    linear = isinstance(true, LinearResponse)
    steps = linear_steps if linear else bracketed(Wall(true))
    curve = fit_curve(steps)
    assert type(curve.response) is type(true)
    if isinstance(curve.response, GammaResponse):
        assert curve.response.gamma == pytest.approx(2.0, rel=0.01)
    assert curve.black == pytest.approx(BLACK, rel=0.03 if response else 0.15)
    seen = np.linspace(0.03, 1, 200)
    assert np.abs(curve.dn(seen) - 255 * response_curve(true, seen)).max() < 0.03 * 255
    noise = photon_transfer(steps, curve, 16)
    assert 1 / noise.level_per_e == pytest.approx(1 / PER_E, rel=0.03)
    assert noise.read_noise_e == pytest.approx(READ_E, rel=0.03 if response else 0.08)
    assert noise.full_well_e == pytest.approx((1 - BLACK) / PER_E, rel=0.03)
    assert noise.scatter < 0.1


def test_debevecs_curve_is_the_same(linear_steps: list[Step]) -> None:
    found = debevec_curve(linear_steps)
    assert (np.diff(found.light_us) >= 0).all()
    for step in measurable(linear_steps):
        if step.gain_db == 0 and step.mean_dn < 240:
            assert found.dn(step.exposure_us) == pytest.approx(step.mean_dn, abs=2.5)


def test_the_real_gains_are_measured(linear_steps: list[Step]) -> None:
    gains = fit_curve(linear_steps).gains
    assert gains[12.0] == pytest.approx(gain_factor(12), rel=0.005)
    assert gains[24.0] == pytest.approx(gain_factor(24), rel=0.005)


def test_noise_is_over_time_and_without_flicker() -> None:
    rng = np.random.default_rng(1)
    pattern = rng.normal(0, 9, (96, 128))
    frames = [
        Frame(
            np.rint(100 + 3 * k + pattern + rng.normal(0, 2, pattern.shape)).astype(np.uint8),
            "mono8", k, 0, 0, Settings(1000.0, 0.0),
        )
        for k in range(4)
    ]  # fmt: skip
    step = summarise_step(frames)
    assert step.noise_dn == pytest.approx(np.hypot(2, 12**-0.5), rel=0.03)
    assert step.flicker == pytest.approx(np.std([0, 3, 6, 9], ddof=1) / 104.5, rel=0.05)


def test_steps_at_the_ends_and_without_noise_are_no_measure() -> None:
    def step(mean_dn: float, noise_dn: float) -> Step:
        return Step(100.0, 0.0, mean_dn, noise_dn, 0.0, np.zeros((16, 16), np.uint8))

    good, white = step(120, 1.5), step(255, 0)
    bad = [white, step(4, 0.1), step(4.5, 0.5), step(253, 1.5), step(2, 1.5)]
    assert measurable([good, *bad]) == [good]


def test_a_level_behind_a_bent_curve_has_the_noise_that_made_it() -> None:
    curve = Curve(GammaResponse(gamma=2.2), 0.0, 1.0, {0.0: 1.0})
    rng = np.random.default_rng(2)
    seen = curve.dn(np.maximum(0.02 + rng.normal(0, 0.004, 200_000), 0))
    assert curve.level_noise(0.02, float(seen.std())) == pytest.approx(0.004, rel=0.01)


def test_a_lamp_that_flickers_is_named() -> None:
    with pytest.raises(CalibrationError, match=r"primary: the light flickers: .* direct current"):
        bracketed(Wall(light=lambda number: 1.0 if number % 2 else 0.9))


def test_a_lamp_that_warms_up_is_named() -> None:
    with pytest.raises(CalibrationError, match=r"light changed by \+\d.\d% during the bracket"):
        bracketed(Wall(light=lambda number: 1 + number * 2e-4))


def test_too_little_light_is_named() -> None:
    with pytest.raises(CalibrationError, match=r"not saturated: too dark; add light"):
        bracketed(Wall(light=lambda _: 0.05))


def test_too_much_light_is_named() -> None:
    with pytest.raises(CalibrationError, match="saturated even at 11 us: too bright; take light"):
        bracketed(Wall(light=lambda _: 1e5))


def test_light_from_one_side_is_named() -> None:
    wall = Wall()
    wall.tilt = np.linspace(0.8, 1.2, 128)[None, :] * np.ones((96, 1))
    with pytest.raises(CalibrationError, match=r"uneven surface: .* light it from both sides"):
        bracketed(wall)


def test_a_camera_that_exposes_by_itself_is_named() -> None:
    wall = Wall()
    wall.obeys = False
    with pytest.raises(CalibrationError, match=r"got 5000 us and 0\.0 dB .* own exposure control"):
        bracketed(wall)


def test_settings_that_come_late_are_waited_for() -> None:
    wall, bracket = Wall(), Bracket("secondary", LIMITS)
    late = [bracket.settings] * 4
    for _ in range(2_000):
        late.append(bracket.settings)
        bracket.see(wall.shoot(late.pop(0)))
        if bracket.done:
            break
    assert bracket.done
    assert all(step.flicker < 0.01 for step in bracket.steps)


def test_a_bracket_begins_and_ends_alike(linear_steps: list[Step]) -> None:
    first, last = linear_steps[0], linear_steps[-1]
    assert (first.exposure_us, first.gain_db) == (last.exposure_us, last.gain_db)
    assert {step.gain_db for step in linear_steps} == {0.0, 12.0, 24.0}
    assert FRAMES_EACH >= 2


def test_too_few_usable_steps_are_named(linear_steps: list[Step]) -> None:
    silent = [replace(step, noise_dn=0.1) for step in linear_steps]
    with pytest.raises(CalibrationError, match=r"only 0 of .* steps are neither black, white"):
        fit_curve(silent)


def test_toml_of_tables_in_tables_is_read_back() -> None:
    import tomllib

    values = {"name": 'a "b"', "response": {"curve": "table", "table": [0.0, 0.5]}, "none": None}
    assert tomllib.loads(to_toml(values)) == {
        "name": 'a "b"',
        "response": {"curve": "table", "table": [0.0, 0.5]},
    }
