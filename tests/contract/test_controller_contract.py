"""What every controller keeps, whatever it thinks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from network_files import linear
from numpy.typing import NDArray

from rig.controllers.registry import ALIASES, CONTROLLERS, make_controller
from rig.core.autoexposure import AutoExposure, metered_dn
from rig.core.protocols import Controller
from rig.core.types import THESIS_LIMITS, Auto, Command, Frame, Limits, Settings
from rig.core.units import gain_factor

SHAPE = (48, 64)
INDOOR, DAYLIGHT = 0.01, 0.2
"""Grey levels per microsecond of a white surface, at 0 dB."""

NARROW_LIMITS = Limits((500.0, 9_000.0), (3.0, 12.0))


def wall(seed: int) -> NDArray[np.float64]:
    """Return a wall of 4 x 4 pixel stones: with every pixel by itself it would be noise."""
    stones = np.random.default_rng(seed).uniform(0.1, 1.0, (SHAPE[0] // 4, SHAPE[1] // 4))
    return np.repeat(np.repeat(stones, 4, axis=0), 4, axis=1)


@dataclass(slots=True)
class AnalyticCamera:
    """A noiseless camera before a textured wall: grey = clip(light x texture x brightness)."""

    limits: Limits = THESIS_LIMITS
    sequence: int = 0
    auto: AutoExposure | None = None
    asked: Auto | None = None
    texture: NDArray[np.float64] = field(default_factory=lambda: wall(7))

    def shoot(self, command: Command, light_dn_per_us: float) -> Frame:
        used = self.settings(command)
        brightness = light_dn_per_us * used.exposure_us * gain_factor(used.gain_db)
        image = np.clip(self.texture * brightness, 0, 255).astype(np.uint8)
        if self.auto is not None:
            assert self.asked is not None
            self.auto = self.auto.after(metered_dn(image, self.asked.metering))
        self.sequence += 1
        time_ns = self.sequence * 100_000_000
        return Frame(image, "bayer_rggb8", self.sequence - 1, time_ns, time_ns, used)

    def settings(self, command: Command) -> Settings:
        if isinstance(command, Settings):
            self.auto = None
            return command.clamp(self.limits)
        if self.auto is None or command != self.asked:
            self.asked = command
            self.auto = AutoExposure.begun(command)
        return self.auto.settings


def write_brightness_network(path: Path) -> Path:
    """Write a network that lowers its exposure when its pictures are bright."""
    weights = np.zeros((15, 2), np.float32)
    weights[:9] = -0.02 / 9
    return linear(path, weights, (0.05, 0.01))


SPECS = {
    "ae": "ae",
    "ae-quick": "ae:gain_db=6,damping=0.1,target_dn=90",
    "aeag": "aeag",
    "aeag-quick": "aeag:metering=lower,priority=exposure,damping=0",
    "aeag-spot": "aeag:metering=spot",
    "aeag-vendor": "aeag:preset=vendor",
    "fixed": "fixed:exposure_us=2000,gain_db=6",
    "geomean": "geomean",
    "geomean-slow": "geomean:target=0.2,speed=0.4,exposure_us_max=4000",
    "kim": "kim",
    "kim-short": "kim:evaluations_max=5,keep=0.4",
    "lu": "lu",
    "mean": "mean",
    "mean-70": "mean-70",
    "mean-capped": "mean:percent=30,speed=0.6,exposure_us_max=4000",
    "network": "network:model={model}",
    "shim": "shim",
    "shim-2018": "shim:version=2018",
    "shim-split": "shim:gain=split,exposure_us_max=5000",
    "shin": "shin",
    "shin-cpp": "shin:variant=authors-cpp,tolerance=high",
    "zhang": "zhang",
    "zhang-fixed": "zhang:gain=fixed,gain_db=6",
    "zhang-split": "zhang:gain=split,exposure_us_max=5000",
}
CREEPING = ("zhang",)
"""Controllers whose published steps are tiny: they get 300 frames to settle instead of 120."""
MakeController = Callable[[], Controller]


def test_every_controller_is_held_to_the_contract() -> None:
    named = {spec.partition(":")[0] for spec in SPECS.values()}
    assert named - set(ALIASES) == set(CONTROLLERS)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_brightness_network(tmp_path_factory.mktemp("network") / "brightness.onnx")


@pytest.fixture(params=sorted(SPECS))
def make(request: pytest.FixtureRequest, model: Path) -> MakeController:
    spec = SPECS[request.param].format(model=model)
    return lambda: make_controller(spec, seed=0, networks={}).controller


def drive(
    controller: Controller,
    lights: list[float],
    limits: Limits = THESIS_LIMITS,
    restamp: Callable[[Frame], Frame] = lambda frame: frame,
) -> tuple[list[Command], list[Settings], list[NDArray[np.uint8]]]:
    """Return the commands, the settings used and the pictures of one frame per light."""
    camera = AnalyticCamera(limits)
    commands, used, images = [controller.reset(limits)], [], []
    for light in lights:
        frame = camera.shoot(commands[-1], light)
        used.append(frame.used)
        images.append(frame.image)
        commands.append(controller.step(restamp(frame)))
        for value in controller.diagnostics().values():
            assert isinstance(value, str) or np.isfinite(value)
    return commands, used, images


FLICKER = [INDOOR, DAYLIGHT, 0.0, 1e3] * 10 + [INDOOR] * 30 + [0.0] * 30 + [1e4] * 30 + [1.0] * 30


@pytest.mark.parametrize("limits", [THESIS_LIMITS, NARROW_LIMITS])
def test_commands_stay_within_the_limits(make: MakeController, limits: Limits) -> None:
    for command in drive(make(), FLICKER, limits)[0]:
        if isinstance(command, Auto):
            assert command.limits == command.limits.within(limits)
            assert command.start == command.start.clamp(command.limits)
        else:
            assert command == command.clamp(limits)


def test_the_same_frames_give_the_same_commands(make: MakeController) -> None:
    once = drive(make(), FLICKER)[0]
    controller = make()
    assert drive(controller, FLICKER)[0] == once
    assert drive(controller, FLICKER)[0] == once, "reset must forget everything"


def test_sequence_numbers_and_times_decide_nothing(make: MakeController) -> None:
    def restamp(frame: Frame) -> Frame:
        noise = np.random.default_rng(frame.sequence).integers(0, 2**40, 3).tolist()
        return replace(frame, sequence=noise[0], device_time_ns=noise[1], host_time_ns=noise[2])

    lights = [INDOOR] * 40 + [DAYLIGHT] * 40
    assert drive(make(), lights, restamp=restamp)[0] == drive(make(), lights)[0]


def test_the_picture_is_left_as_it_was(make: MakeController) -> None:
    camera = AnalyticCamera()
    controller = make()
    frame = camera.shoot(controller.reset(THESIS_LIMITS), INDOOR)
    frame.image.setflags(write=False)
    before = frame.image.copy()
    controller.step(frame)
    assert np.array_equal(frame.image, before)


@pytest.mark.parametrize("light", [INDOOR, DAYLIGHT])
def test_it_settles_and_holds_on_constant_light(
    make: MakeController, light: float, request: pytest.FixtureRequest
) -> None:
    creeps = request.node.callspec.params["make"].startswith(CREEPING)
    _, used, _ = drive(make(), [light] * (300 if creeps else 120))
    assert len(set(used[-20:])) == 1


@pytest.mark.parametrize("before", [0.0, 1e5])
def test_it_recovers_from_black_and_from_white(make: MakeController, before: float) -> None:
    _, used, images = drive(make(), [before] * 100 + [INDOOR * 3] * 120)
    assert 20 < images[-1].mean() < 235
    assert len(set(used[-10:])) == 1
