"""Many controllers, each alone with one simulated camera, on the same drive.

What a camera sees depends on where it is, not on its settings: every view is rendered once and
exposed by every controller in turn. Otherwise each has what it has in a race on the primary camera:
its limits, its noise, the camera's rounding, and settings that count from the next frame on.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field

import numpy as np

from rig.controllers.registry import NamedController
from rig.core.errors import UsageError
from rig.core.types import THESIS_LIMITS, Frame, Settings
from rig.core.units import NS_PER_S
from rig.drivers.registry import open_source, parse_address
from rig.drivers.scenes.scene import View
from rig.drivers.sensor.sensor import Sensor
from rig.drivers.simulated.program import ExposureProgram
from rig.drivers.simulated.source import SimulatedSource
from rig.evaluation.inliers import InlierCounter, grey_of
from rig.evaluation.statistics import BLIND_BELOW, counted, inlier_statistics
from rig.vision.metrics import mean_dn
from rig.vision.orb import OrbFrontEnd


@dataclass(frozen=True, slots=True)
class Solo:
    """How one controller did: ORB inliers from the race's judge, settings used at every frame."""

    controller: str
    world_version: str
    median: float
    min: int
    blind_frames: int
    used: tuple[Settings, ...] = field(repr=False)
    mean_dn: tuple[float, ...] = field(repr=False)


class _Seat:
    """One controller, what its camera will use next, and what it has seen."""

    def __init__(self, named: NamedController, source: SimulatedSource) -> None:
        controls = source.drive.model.controls
        self.named = named
        self._program = ExposureProgram(controls, source.drive.latency_frames)
        self._counter = InlierCounter(OrbFrontEnd())
        self._program.ask(named.controller.reset(controls.limits.within(THESIS_LIMITS)))
        self.used: list[Settings] = []
        self.means_dn: list[float] = []
        self.inliers: list[float] = []

    def shoot(self, view: View, sensor: Sensor, source: SimulatedSource, trigger: int) -> None:
        """Take, judge and answer one frame."""
        used = self._program.next_exposure()
        seeds = np.random.SeedSequence([source.drive.noise_seed, 0, trigger])
        noise_seed = int(seeds.generate_state(1, np.uint64)[0])
        image = sensor.develop(view.exposed(used.exposure_us), used, noise_seed)
        self._program.saw(image)
        time_ns = round(source.drive.scene_time_s(trigger) * NS_PER_S)
        pixel_format = source.drive.model.picture.format
        frame = Frame(image, pixel_format, trigger, time_ns, time_ns, used)
        self.used.append(used)
        self.means_dn.append(mean_dn(image))
        self.inliers.append(self._counter.count(trigger, grey_of(frame)))
        self._program.ask(self.named.controller.step(frame))

    def result(self, world_version: str) -> Solo:
        triggers = np.arange(len(self.inliers))
        statistics = inlier_statistics(
            counted(triggers, np.array(self.inliers)), BLIND_BELOW["orb"]
        )
        return Solo(
            self.named.name,
            world_version,
            statistics.median or 0.0,
            statistics.min or 0,
            statistics.blind_frames,
            tuple(self.used),
            tuple(self.means_dn),
        )


def run_solo(
    address: str, controllers: Sequence[NamedController], *, seed: int, frames: int | None = None
) -> list[Solo]:
    """Return how each controller did on the drive that `address` names.

    `frames` None is the whole drive. Raises UsageError for an address that is no simulation in
    this process.
    """
    if parse_address(address).scheme != "sim":
        raise UsageError(f"{address}: only a sim: address can be driven by one controller")
    with closing(open_source(address, seed=seed)) as source:
        assert isinstance(source, SimulatedSource)
        lens = source.scene.intrinsics("primary")
        sensor = Sensor(source.drive.model, (lens.height_px, lens.width_px), seed=0)
        seats = [_Seat(named, source) for named in controllers]
        for trigger in range(frames or source.drive_triggers):
            view = source.scene.view("primary", source.drive.scene_time_s(trigger))
            for seat in seats:
                seat.shoot(view, sensor, source, trigger)
        return [seat.result(source.world_version) for seat in seats]
