"""Shin's search: where it starts, what it believes, when it rests and when it starts again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.controllers.shin import ShinController, initial_simplex
from rig.core.types import THESIS_LIMITS, Command, Frame, Limits, Settings
from rig.core.units import gain_factor

Texture = NDArray[np.float64]
TEXTURE = np.repeat(
    np.repeat(np.random.default_rng(8).uniform(0, 1, (16, 20)), 4, axis=0), 4, axis=1
)


@dataclass(slots=True)
class SlowCamera:
    """A camera whose settings take effect `latency` frames late."""

    latency: int = 0
    dn_per_us: float = 0.2
    asked: list[Settings] = field(default_factory=list)

    def shoot(self, command: Command) -> Frame:
        assert isinstance(command, Settings)
        self.asked.append(command)
        used = self.asked[max(len(self.asked) - 1 - self.latency, 0)]
        brightness = self.dn_per_us * used.exposure_us * gain_factor(used.gain_db)
        image = np.clip(TEXTURE * brightness, 0, 255).astype(np.uint8)
        return Frame(image, "mono8", len(self.asked) - 1, 0, 0, used)


def drive(
    controller: ShinController, camera: SlowCamera, frames: int, limits: Limits = THESIS_LIMITS
) -> list[Frame]:
    command = controller.reset(limits) if not camera.asked else controller._command
    taken = []
    for _ in range(frames):
        taken.append(camera.shoot(command))
        command = controller.step(taken[-1])
    return taken


def phase(controller: ShinController) -> object:
    return controller.diagnostics()["phase"]


@pytest.mark.parametrize(
    ("mean_dn", "h"), [(0.0, 1.7), (100.0, 1.7 * (1 - 100 / 255)), (255.0, -1 / 1.7)]
)
def test_the_first_simplex_is_the_authors(mean_dn: float, h: float) -> None:
    corners = initial_simplex(Settings(2_000.0, 10.0), mean_dn, THESIS_LIMITS)
    expected = [(2_000, 10), (2_000, 10 * (1 + h)), (2_000 * (1 + h), 10)]
    assert np.array(corners) == pytest.approx(np.array(expected))


@pytest.mark.parametrize("mean_dn", [0.0, 60.0, 127.0, 128.0, 200.0, 255.0])
@pytest.mark.parametrize("exposure_us", [75.0, 76.0, 3_000.0, 29_000.0, 30_000.0])
@pytest.mark.parametrize("gain_db", [0.0, 0.1, 15.0, 29.0, 30.0])
def test_the_first_simplex_has_an_area_inside_the_limits(
    mean_dn: float, exposure_us: float, gain_db: float
) -> None:
    corners = initial_simplex(Settings(exposure_us, gain_db), mean_dn, THESIS_LIMITS)
    start, other_gain, other_exposure = corners
    assert abs(other_gain[1] - start[1]) >= 3
    assert abs(other_exposure[0] / start[0] - 1) >= 0.09
    for exposure, gain in corners:
        assert Settings(exposure, gain) == Settings(exposure, gain).clamp(THESIS_LIMITS)


def test_a_fixed_gain_leaves_a_search_over_exposure() -> None:
    limits = Limits((75.0, 30_000.0), (10.0, 10.0))
    controller, camera = ShinController(), SlowCamera(dn_per_us=0.02)
    taken = drive(controller, camera, 80, limits)
    assert {frame.used.gain_db for frame in taken} == {10.0}
    assert phase(controller) == "hold"
    assert 60 < taken[-1].image.mean() < 220


def test_it_rests_on_the_best_frame_that_it_saw() -> None:
    controller, camera = ShinController(), SlowCamera()
    scores = {}
    command = controller.reset(THESIS_LIMITS)
    while not scores or phase(controller) == "search":
        frame = camera.shoot(command)
        command = controller.step(frame)
        scores[frame.used] = controller.diagnostics()["score"]
    assert len(scores) <= 50
    assert command == max(scores, key=lambda used: float(scores[used]))


@pytest.mark.parametrize(("tolerance", "searches"), [("0.001", 2.0), ("5", 1.0)])
def test_a_change_beyond_the_tolerance_starts_a_new_search(tolerance: str, searches: float) -> None:
    controller, camera = ShinController(tolerance=tolerance), SlowCamera()
    drive(controller, camera, 60)
    assert (phase(controller), controller.diagnostics()["searches"]) == ("hold", 1.0)
    camera.dn_per_us *= 0.5
    drive(controller, camera, 1)
    assert controller.diagnostics()["searches"] == searches


def test_frames_that_are_late_say_nothing_of_the_place_at_rest() -> None:
    controller, camera = ShinController(tolerance="mid"), SlowCamera()
    drive(controller, camera, 200)
    rest = controller._command
    assert phase(controller) == "hold" and isinstance(rest, Settings)
    stale = SlowCamera().shoot(Settings(rest.exposure_us / 4, rest.gain_db))
    assert [controller.step(stale) for _ in range(3)] == [rest] * 3
    assert phase(controller) == "hold"
    assert controller.step(camera.shoot(rest)) == rest


def test_late_settings_are_waited_for() -> None:
    """While steps are larger than what counts as arrived, latency only costs frames."""
    prompt, late = SlowCamera(latency=0), SlowCamera(latency=3)
    quick, patient = ShinController(), ShinController()
    drive(quick, prompt, 60)
    drive(patient, late, 240)
    assert phase(quick) == phase(patient) == "hold"
    assert list(dict.fromkeys(late.asked))[:12] == list(dict.fromkeys(prompt.asked))[:12]


def test_settings_that_never_arrive_are_taken_as_used() -> None:
    """A camera that stays at 1 ms: the search goes on with what was used, and ends."""
    controller, camera = ShinController(), SlowCamera(latency=10**6)
    taken = drive(controller, camera, 600)
    assert {frame.used for frame in taken} == {Settings(1_000.0, 0.0)}
    assert controller.diagnostics()["evaluations"] != 1


def test_lost_light_ends_a_search_within_three_frames() -> None:
    controller, camera = ShinController(), SlowCamera()
    drive(controller, camera, 5)
    assert phase(controller) == "search"
    camera.dn_per_us = 0.0
    drive(controller, camera, 3)
    assert phase(controller) == "flat"
    camera.dn_per_us = 0.2
    drive(controller, camera, 3)
    assert phase(controller) == "search"


@pytest.mark.parametrize("value", [0, 90, 255])
def test_a_flat_wall_is_brought_to_mid_grey(value: int) -> None:
    controller = ShinController()
    controller.reset(THESIS_LIMITS)
    used = Settings(3_000.0, 0.0)
    frame = Frame(np.full((40, 40), value, np.uint8), "mono8", 0, 0, 0, used)
    command = controller.step(frame)
    assert isinstance(command, Settings)
    assert (command.exposure_us > used.exposure_us) == (value < 128)


@pytest.mark.parametrize(("dn_per_us", "frames"), [(0.04, 2), (5.0, 2)])
def test_a_search_begins_from_a_picture_that_shows_something(dn_per_us: float, frames: int) -> None:
    controller, camera = ShinController(), SlowCamera(dn_per_us=dn_per_us)
    taken = drive(controller, camera, 1)
    assert (phase(controller), controller.diagnostics()["evaluations"]) == ("centre", 0.0)
    drive(controller, camera, frames)
    assert phase(controller) == "search"
    assert (camera.asked[-1].exposure_us > taken[0].used.exposure_us) == (dn_per_us < 1)


def test_a_dark_world_is_searched_all_the_same() -> None:
    controller, camera = ShinController(), SlowCamera(dn_per_us=4e-5)
    drive(controller, camera, 90)
    assert phase(controller) == "hold"


def test_the_first_frames_at_rest_correct_a_lucky_best() -> None:
    controller, camera = ShinController(tolerance="0.01"), SlowCamera()
    drive(controller, camera, 60)
    assert phase(controller) == "hold"
    seen = float(controller.diagnostics()["score"])
    assert controller._best is not None
    controller._best = replace(controller._best, cost=-seen - 0.09)
    controller._looks.clear()
    drive(controller, camera, 5)
    assert (phase(controller), controller.diagnostics()["searches"]) == ("hold", 1.0)
    assert controller._best.cost == pytest.approx(-seen, abs=1e-3)


def test_a_short_search_can_be_asked_for() -> None:
    controller, camera = ShinController(evaluations_max=6), SlowCamera()
    drive(controller, camera, 6)
    assert (phase(controller), controller.diagnostics()["evaluations"]) == ("hold", 6.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ShinController(tolerance="midd"), "tolerance must be low, mid, high or a number"),
        (lambda: ShinController(tolerance="-1"), "got '-1'"),
        (lambda: ShinController(variant="author"), "did you mean 'authors'"),
        (lambda: ShinController(cost_spread=-1.0), "cost_spread must be >= 0"),
        (lambda: ShinController(evaluations_max=2), "evaluations_max must be >= 3"),
    ],
)
def test_bad_options_are_refused(make: Callable[[], ShinController], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_before_the_first_frame_there_is_nothing_to_tell() -> None:
    assert ShinController().diagnostics() == {}
