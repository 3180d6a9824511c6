"""What each rival of the field thinks, told on pictures whose answer is known."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.controllers.ae import AeController
from rig.controllers.aeag import AeagController
from rig.controllers.gaussian import maxmi, posterior
from rig.controllers.geomean import GeomeanController
from rig.controllers.kim import KimController
from rig.controllers.lu import LuController
from rig.controllers.registry import make_controller
from rig.controllers.shim import GAMMAS, ShimController, best_gamma
from rig.controllers.split import brightness_us, scaled, split, towards_middle
from rig.controllers.zhang import IRRADIANCE_PER_US, RATES, ZhangController, ascent_rate, gain_share
from rig.core.errors import UsageError
from rig.core.protocols import Controller
from rig.core.types import THESIS_LIMITS, Auto, Frame, Limits, Settings
from rig.core.units import gain_factor

STONES = np.random.default_rng(8).uniform(0.05, 1, (20, 30))
WALL = np.repeat(np.repeat(STONES, 8, axis=0), 8, axis=1)


def shoot(used: Settings, dn_per_us: float = 0.05, wall: NDArray[np.float64] = WALL) -> Frame:
    grey = wall * dn_per_us * used.exposure_us * gain_factor(used.gain_db)
    return Frame(np.clip(grey, 0, 255).astype(np.uint8), "mono8", 0, 0, 0, used)


def settle(controller: Controller, frames: int, dn_per_us: float = 0.05) -> list[Settings]:
    command = controller.reset(THESIS_LIMITS)
    used = []
    for _ in range(frames):
        assert isinstance(command, Settings)
        used.append(command)
        command = controller.step(shoot(command, dn_per_us))
    return used


@pytest.mark.parametrize(
    ("wanted_us", "expected"),
    [
        (500.0, (500.0, 0.0)),
        (4_000.0, (4_000.0, 0.0)),
        (40_000.0, (4_000.0, 20.0)),
        (10.0, (75.0, 0.0)),
        (1e9, (4_000.0, 30.0)),
    ],
)
def test_the_split_raises_gain_last(wanted_us: float, expected: tuple[float, float]) -> None:
    found = split(wanted_us, THESIS_LIMITS, 4_000.0)
    assert (found.exposure_us, found.gain_db) == pytest.approx(expected)


def test_a_fixed_gain_stays_and_a_split_one_makes_up_for_the_cap() -> None:
    used = Settings(3_000.0, 6.0)
    fixed = scaled(used, 2.0, THESIS_LIMITS, "fixed", 30_000.0)
    assert (fixed.exposure_us, fixed.gain_db) == (6_000.0, 6.0)
    both = scaled(used, 2.0, THESIS_LIMITS, "split", 4_000.0)
    assert both.exposure_us == 4_000.0
    assert brightness_us(both) == pytest.approx(2 * brightness_us(used))


def test_towards_the_middle_no_faster_than_the_built_in_law() -> None:
    assert (towards_middle(0), towards_middle(255), towards_middle(128)) == (1.421, 0.885, 1.0)


def test_ae_keeps_its_gain_and_aeag_knows_the_vendor() -> None:
    command = AeController(gain_db=10.0).reset(THESIS_LIMITS)
    assert isinstance(command, Auto)
    assert command.limits == Limits((75.0, 4_000.0), (10.0, 10.0))
    assert command.start.gain_db == 10.0
    narrow = AeController(gain_db=20.0).reset(Limits((75.0, 9_000.0), (3.0, 12.0)))
    assert isinstance(narrow, Auto)
    assert narrow.limits.gain_db == (12.0, 12.0)
    vendor = make_controller("aeag:preset=vendor", seed=0, networks={}).controller
    assert vendor == AeagController(110.0, 0.5, 30_000.0, "average", "gain")
    own = make_controller("aeag:preset=vendor,damping=0.2", seed=0, networks={})
    assert own.options["damping"] == "0.2"
    with pytest.raises(UsageError, match="unknown preset 'vendr'; did you mean 'vendor'"):
        make_controller("aeag:preset=vendr", seed=0, networks={})


def test_an_alias_is_a_controller_with_an_option() -> None:
    named = make_controller("mean-30:speed=0.5", seed=0, networks={})
    assert (named.options["percent"], named.options["speed"]) == ("30.0", "0.5")


def test_geomean_brings_the_geometric_mean_to_its_target() -> None:
    controller = GeomeanController(target=0.3, speed=1.0, exposure_us_max=30_000.0)
    last = settle(controller, 12)[-1]
    image = np.maximum(shoot(last).image, 1)
    assert np.exp(np.log(image).mean()) == pytest.approx(0.3 * 255, rel=0.06)


def test_shim_finds_the_gamma_at_which_information_peaks() -> None:
    gammas = GAMMAS[2014]
    for peak in (0.4, 1.0, 1.6):
        information = [1 - (gamma - peak) ** 2 for gamma in gammas]
        assert best_gamma(gammas, information) == pytest.approx(peak, abs=0.02)


@pytest.mark.parametrize("version", [2014, 2018])
def test_shim_moves_exposure_by_the_published_law(version: int) -> None:
    controller = ShimController(version=version, kp=0.2)
    dark, bright = controller._factor(0.6), controller._factor(1.6)
    if version == 2014:
        assert (dark, bright) == (pytest.approx(1 + 0.2 * 0.4), pytest.approx(1 - 0.1 * 0.6))
    else:
        turn = math.atan(10)
        assert dark == pytest.approx(1 + 0.2 * 0.1 * math.tan(1.4 * turn - turn))
        assert bright == pytest.approx(1 + 0.1 * 0.1 * math.tan(0.4 * turn - turn))
    assert controller._factor(1.0) == pytest.approx(1.0)


def test_shim_2014_has_its_own_gain() -> None:
    named = make_controller("shim:version=2014", seed=0, networks={})
    assert (named.options["version"], named.options["kp"]) == ("2014", "0.2")
    given = make_controller("shim:version=2014,kp=0.7", seed=0, networks={})
    assert given.options["kp"] == "0.7"


def test_shim_leaves_the_dark_and_the_white_behind() -> None:
    for dn_per_us in (0.005, 5.0):
        last = settle(ShimController(gain_db=0), 200, dn_per_us)[-1]
        assert 25 < shoot(last, dn_per_us).image.mean() < 220


def test_the_rate_of_ascent_is_the_authors_table() -> None:
    for irradiance, rate in zip(IRRADIANCE_PER_US, RATES, strict=True):
        assert ascent_rate(irradiance) == pytest.approx(rate)
    assert ascent_rate(6e-6) == pytest.approx(2.5 + 1)
    assert ascent_rate(0.1) < RATES[-1]
    assert (gain_share(0.0), gain_share(40.0)) == (1.0, 0.1)
    assert gain_share(6.0206) == pytest.approx(0.8, abs=1e-4)


def test_zhang_falls_back_on_the_mean_and_steps_by_a_tenth() -> None:
    controller = ZhangController(gain="fixed")
    controller.reset(THESIS_LIMITS)
    for dn_per_us, ratio in ((0.001, 1.1), (5.0, 0.9)):
        command = controller.step(shoot(Settings(3_000.0, 0.0), dn_per_us))
        assert isinstance(command, Settings)
        assert command.exposure_us == pytest.approx(3_000 * ratio)
        assert controller.diagnostics()["phase"] == "mean"


def test_zhang_climbs_until_over_exposure_pulls_it_back() -> None:
    last = settle(ZhangController(gain="fixed", exposure_us_max=30_000.0), 400)[-1]
    image = shoot(last).image
    assert 100 < image.mean() <= 190
    assert np.percentile(image, 99) > 200


@pytest.mark.parametrize(
    ("exposure_us", "gain_db", "change_db"),
    [(9_800.0, 3.0, 1.0), (1_900.0, 3.0, -1.0), (1_900.0, 0.0, 0.0), (5_000.0, 3.0, 0.0)],
)
def test_zhang_moves_gain_where_exposure_passes_its_marks(
    exposure_us: float, gain_db: float, change_db: float
) -> None:
    moved = ZhangController(exposure_us_max=30_000.0)._move(Settings(exposure_us, gain_db), 1.05)
    assert moved.gain_db == pytest.approx(gain_db + change_db)
    expected = 1.05 * brightness_us(Settings(exposure_us, gain_db))
    assert brightness_us(moved) == pytest.approx(expected)


def test_the_posterior_is_the_textbooks() -> None:
    rng = np.random.default_rng(4)
    points, values, candidates = (
        rng.normal(size=(5, 2)),
        rng.normal(size=5),
        rng.normal(size=(9, 2)),
    )

    def kernel(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array([[math.exp(-((x - y) ** 2).sum() / (2 * 0.7**2)) for y in b] for x in a])

    inverse = np.linalg.inv(kernel(points, points) + 0.1**2 * np.eye(5))
    across = kernel(candidates, points)
    found = posterior(points, values, candidates, 0.7, 0.1)
    assert found.mean == pytest.approx(across @ inverse @ values)
    assert found.variance == pytest.approx(1 - np.diag(across @ inverse @ across.T))
    acquisition = maxmi(found, 50.0, 0.3)
    expected = found.mean + math.sqrt(50) * (np.sqrt(found.variance**2 + 0.3) - math.sqrt(0.3))
    assert acquisition == pytest.approx(expected)


def test_kim_looks_at_new_places_and_rests_on_the_best() -> None:
    controller = KimController()
    command = controller.reset(THESIS_LIMITS)
    metrics: dict[Settings, float] = {}
    for _ in range(40):
        assert isinstance(command, Settings)
        frame = shoot(command)
        command = controller.step(frame)
        if controller.diagnostics()["phase"] == "hold":
            break
        metrics[frame.used] = float(controller.diagnostics()["metric"])
    assert len(metrics) == controller.evaluations_max, "no place is looked at twice"
    metrics[frame.used] = float(controller.diagnostics()["metric"])
    assert command == max(metrics, key=lambda used: metrics[used])


def test_lu_finds_the_most_entropy_and_searches_again_in_other_light() -> None:
    controller = LuController()
    used = settle(controller, 16)
    assert controller.diagnostics()["phase"] == "hold"
    rest = used[-1]
    shares = (math.log(rest.exposure_us / 75, 400), rest.gain_db / 30)
    assert shares[0] == pytest.approx(shares[1])
    controller.step(shoot(rest, 0.05))
    assert controller.diagnostics()["searches"] == 1
    controller.step(shoot(rest, 0.2))
    assert controller.diagnostics()["searches"] == 2


@pytest.mark.parametrize("make", [KimController, LuController])
def test_late_settings_only_cost_frames(make: Callable[[], Controller]) -> None:
    def looked_at(latency: int) -> list[Settings]:
        controller = make()
        asked = [controller.reset(THESIS_LIMITS)]
        for _ in range(25 * (latency + 1)):
            late = asked[max(len(asked) - 1 - latency, 0)]
            assert isinstance(late, Settings)
            asked.append(controller.step(shoot(late)))
        return [step for step in dict.fromkeys(asked) if isinstance(step, Settings)]

    assert looked_at(3)[:10] == looked_at(0)[:10]


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("geomean:target=0", "target must be above 0"),
        ("geomean:speed=2", "speed must be above 0"),
        ("geomean:exposure_us_max=-1", "exposure_us_max must be > 0"),
        ("shim:version=2016", "version must be 2014 or 2018"),
        ("shim:kp=0", "kp must be > 0"),
        ("shim:d=-1", "d must be > 0"),
        ("shim:gain=auto", "gain must be fixed or split"),
        ("zhang:pivot=1", "pivot must be between 0 and 1"),
        ("zhang:rate=0", "rate must be > 0"),
        ("zhang:gain=auto", "gain must be heuristic, fixed, split"),
        ("kim:evaluations_max=1", "evaluations_max must be >= 2"),
        ("kim:alpha=0", "alpha must be > 0"),
        ("kim:gain_db_max=-3", "gain_db must be finite"),
        ("lu:threshold_dn=0", "threshold_dn must be > 0"),
        ("lu:coarse=2", "coarse must be >= 3"),
        ("lu:halvings=-1", "halvings must be >= 0"),
        ("ae:damping=1", r"damping must be in \[0, 1\)"),
        ("shin:rounds=0", "rounds must be >= 1"),
    ],
)
def test_bad_options_are_refused(spec: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        make_controller(spec, seed=0, networks={})
