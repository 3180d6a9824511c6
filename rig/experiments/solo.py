"""Many controllers, each alone with one simulated camera, on the same drive.

What a camera sees depends on where it is, not on its settings: every view is rendered once and
exposed by every controller in turn. Otherwise each has what it has in a race on the primary camera:
its limits, its noise, the camera's rounding, settings that count from the next frame on, and the
judges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field

import numpy as np

from rig.controllers.registry import NamedController
from rig.core.errors import UsageError
from rig.core.types import THESIS_LIMITS, Frame, Intrinsics, Settings
from rig.core.units import NS_PER_S
from rig.drivers.addresses import parse_address
from rig.drivers.registry import open_source
from rig.drivers.scenes.scene import View
from rig.drivers.sensor.sensor import Sensor
from rig.drivers.simulated.program import ExposureProgram
from rig.drivers.simulated.source import SimulatedSource
from rig.evaluation.front_ends import FRONT_ENDS, FrontEnds
from rig.evaluation.inliers import grey_of
from rig.evaluation.odometry import OdometryCounter, Step
from rig.evaluation.statistics import (
    BLIND_BELOW,
    WARM_UP_PAIRS,
    InlierStatistics,
    counted,
    inlier_statistics,
)
from rig.vision.metrics import mean_dn


@dataclass(frozen=True, slots=True)
class Solo:
    """How one controller did, by the race's judges, after the warm-up.

    `inliers` maps each front end that judged to its statistics. `steps` are what visual odometry
    made of the pictures, none where viso2 did not judge. `used` and `mean_dn` (0..255) have one
    entry a frame, the warm-up too.
    """

    controller: str
    world_version: str
    inliers: Mapping[str, InlierStatistics]
    steps: tuple[Step, ...] = field(default=(), repr=False)
    used: tuple[Settings, ...] = field(default=(), repr=False)
    mean_dn: tuple[float, ...] = field(default=(), repr=False)


class _Seat:
    """One controller, what its camera will use next, and what it has seen."""

    def __init__(
        self,
        named: NamedController,
        source: SimulatedSource,
        front_ends: FrontEnds,
        lens: Intrinsics,
    ) -> None:
        controls = source.drive.model.controls
        self.named = named
        self._program = ExposureProgram(controls, source.drive.latency_frames)
        self._counters = {name: recipe.counter(lens) for name, recipe in front_ends.items()}
        self._program.ask(named.controller.reset(controls.limits.within(THESIS_LIMITS)))
        self.used: list[Settings] = []
        self.means_dn: list[float] = []
        self.inliers: dict[str, list[float]] = {name: [] for name in front_ends}

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
        grey = grey_of(frame)
        for name, counter in self._counters.items():
            self.inliers[name].append(counter.count(trigger, grey))
        self._program.ask(self.named.controller.step(frame))

    def result(self, world_version: str) -> Solo:
        triggers = np.arange(len(self.used))
        return Solo(
            self.named.name,
            world_version,
            {
                name: inlier_statistics(counted(triggers, np.array(counts)), BLIND_BELOW[name])
                for name, counts in self.inliers.items()
            },
            tuple(step for step in self._steps() if step.trigger >= WARM_UP_PAIRS),
            tuple(self.used),
            tuple(self.means_dn),
        )

    def _steps(self) -> list[Step]:
        counters = self._counters.values()
        return [s for one in counters if isinstance(one, OdometryCounter) for s in one.steps]


def run_solo(
    address: str,
    controllers: Sequence[NamedController],
    *,
    seed: int,
    frames: int | None = None,
    front_ends: FrontEnds = FRONT_ENDS,
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
        seats = [_Seat(named, source, front_ends, lens) for named in controllers]
        for trigger in range(frames or source.drive_triggers):
            view = source.scene.view("primary", source.drive.scene_time_s(trigger))
            for seat in seats:
                seat.shoot(view, sensor, source, trigger)
        return [seat.result(source.world_version) for seat in seats]


def world_version(address: str) -> str:
    """Return the version of the world that a sim: address names."""
    with closing(open_source(address, seed=0)) as source:
        return source.world_version
