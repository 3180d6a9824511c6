"""The simulated pair: two cameras and a wire, looking at a scene that they drive through."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rig.config import CameraModel
from rig.core.clock import VirtualClock
from rig.core.protocols import Camera, Clock
from rig.core.types import SIDES, Intrinsics, Pair, Settings, Side, Truth
from rig.core.units import us_to_ns
from rig.drivers.scenes.scene import FAR_M, Scene
from rig.drivers.sensor.sensor import Sensor
from rig.drivers.simulated.camera import SimulatedCamera, TakePicture, Wiring
from rig.drivers.simulated.world import Link, Wire, World

SERIALS = Pair("SIM-PRIMARY", "SIM-SECONDARY")

EXPOSURE_FOLLOWING_PACE_HZ = 10.0
"""Scene time per trigger when the triggers follow the exposures, so that pictures do not depend
on how long decisions take (about 10 Hz: thesis 5.1.1)."""


@dataclass(frozen=True, slots=True)
class Drive:
    """How the pair is driven through a scene.

    `rate_hz` None triggers as fast as the exposures allow; `noise_seed` makes the noise of every
    frame; `decision_ms` is what one decision costs on the run's clock. With `depth` the truth of a
    trigger holds the depth of the primary's view. With `place_s` it stands still for
    `triggers_a_place`, and the places are so many seconds of the drive apart.
    """

    model: CameraModel
    noise_seed: int
    rate_hz: float | None = EXPOSURE_FOLLOWING_PACE_HZ
    latency_frames: int = 0
    decision_ms: float = 0.0
    depth: bool = False
    triggers_a_place: int = 1
    place_s: float | None = None

    def place(self, trigger: int) -> int:
        """Return the place that a trigger looks from, counted from 0."""
        return trigger // self.triggers_a_place

    def scene_time_s(self, trigger: int) -> float:
        """Return the moment of the scene that a trigger sees."""
        if self.place_s is not None:
            return self.place(trigger) * self.place_s
        return trigger / (self.rate_hz or EXPOSURE_FOLLOWING_PACE_HZ)

    def triggers(self, drive_s: float) -> int:
        """Return how many triggers a drive of `drive_s` seconds takes."""
        places = round(drive_s / self.scene_time_s(self.triggers_a_place))
        return places * self.triggers_a_place


@dataclass(frozen=True, slots=True)
class SimulatedSource:
    """The opened pair; implements `rig.core.protocols.Source`."""

    address: str
    scene: Scene
    drive: Drive
    cameras: Pair[Camera]
    clock: Clock
    real_time: bool = field(default=False, init=False)

    @property
    def intrinsics(self) -> Pair[Intrinsics]:
        """Return the intrinsics of both cameras."""
        return Pair(self.scene.intrinsics("primary"), self.scene.intrinsics("secondary"))

    @property
    def rate_hz(self) -> float | None:
        """Return the pace of the triggers; None follows the exposures."""
        return self.drive.rate_hz

    @property
    def decision_ms(self) -> float:
        """Return what one decision costs on the run's clock."""
        return self.drive.decision_ms

    @property
    def drive_triggers(self) -> int:
        """Return how many triggers the scene's drive takes."""
        return self.drive.triggers(self.scene.drive_s)

    @property
    def world_version(self) -> str:
        """Return the version of the scene's world."""
        return self.scene.world_version

    def pose_index(self, trigger: int) -> int:
        """Return the place of a trigger: every one looks from a new pose unless it stands."""
        return self.drive.place(trigger)

    def truth(self, trigger: int) -> Truth:
        """Return what the scene knows of a trigger."""
        time_s = self.drive.scene_time_s(trigger)
        truth = self.scene.truth(time_s)
        if not self.drive.depth:
            return truth
        depth_m = self.scene.view("primary", time_s).depth_m
        seen = np.where(depth_m < FAR_M, depth_m, np.float32(np.inf))
        return replace(truth, depth_m=seen)

    def close(self) -> None:
        """Close both cameras."""
        for camera in self.cameras:
            camera.close()


def simulate(scene: Scene, drive: Drive, address: str) -> SimulatedSource:
    """Return a pair on a virtual clock: a software trigger of the primary exposes both."""
    clock = VirtualClock()
    world = World(clock)
    timing = drive.model.timing
    link = Link(world, timing.link_bytes_per_s)
    wire = Wire(world, us_to_ns(timing.trigger_delay_us))
    unconnected = Wire(world, 0)
    wirings = Pair(
        Wiring(world, link, output=wire, software_trigger=True, overlap="off"),
        Wiring(world, link, output=unconnected, software_trigger=False, overlap="readout"),
    )
    cameras = Pair(
        *(
            SimulatedCamera(
                serial, drive.model, wiring, photographer(scene, side, drive), drive.latency_frames
            )
            for serial, wiring, side in zip(SERIALS, wirings, SIDES, strict=True)
        )
    )
    wire.inputs.append(cameras.secondary.on_trigger)
    return SimulatedSource(address, scene, drive, Pair[Camera](*cameras), clock)


def photographer(scene: Scene, side: Side, drive: Drive) -> TakePicture:
    """Return what turns a trigger and its settings into the picture of one camera."""
    camera = SIDES.index(side)
    size = scene.intrinsics(side)
    sensor = Sensor(drive.model, (size.height_px, size.width_px), seed=camera)
    look = lru_cache(maxsize=1)(lambda time_s: scene.view(side, time_s))

    def take(sequence: int, used: Settings) -> NDArray[np.uint8]:
        view = look(drive.scene_time_s(sequence))
        seeds = np.random.SeedSequence([drive.noise_seed, camera, sequence])
        noise_seed = int(seeds.generate_state(1, np.uint64)[0])
        moving = drive.place_s is None
        light = view.exposed(used.exposure_us) if moving else view.radiance_cd_m2
        return sensor.develop(light, used, noise_seed)

    return take
