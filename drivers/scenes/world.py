"""A world ready to be looked at: its surfaces, its baked light, its sky and a drive through it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig.core.types import Intrinsics, Side, Truth
from rig.drivers.scenes.blur import flow_blur
from rig.drivers.scenes.cache import Arrays, cached
from rig.drivers.scenes.geometry import Quad, Surfaces, surfaces
from rig.drivers.scenes.light import LIGHT_VERSION, STREET_RAYS, Sunlight, bake
from rig.drivers.scenes.raster import render
from rig.drivers.scenes.textures import Atlas, Image, make_atlas
from rig.drivers.scenes.traffic import MovingTraffic, Traffic, set_moving
from rig.drivers.scenes.trajectories import Drive, Pose, Vector

_FX_PER_WIDTH = 1806.0 / 2048.0
"""The focal length of the thesis' lens and sensor, in picture widths (thesis 5.1)."""

_REMEMBERED_VIEWS = 4

_STRAIGHT_US = 5_000.0
"""A vehicle shakes at up to 24 Hz: over an eighth of a period its way is nearly straight."""


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Something that opens or closes while the drive lasts, and changes the light with it.

    `quads` returns all quads of the world for a share of the change, 0 to 1: always as many, of the
    same sizes; `share` is how far it is at a time. Light is baked at evenly spaced shares.
    """

    quads: Callable[[float], Sequence[Quad]]
    share: Callable[[float], float]
    stages: int


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What a world is made of before any light is baked.

    `key` names everything that `textures` and `sky` were made from.
    `textures` and `sky` are called only when the world is not in the cache. A world has a change,
    or traffic, or neither.
    """

    key: str
    version: str
    quads: Sequence[Quad]
    textures: Callable[[], dict[str, Image]]
    sky: Callable[[], NDArray[np.float32]]
    sun: Sunlight
    drive: Drive
    drive_s: float
    rays: tuple[int, ...] = STREET_RAYS
    change: Change | None = None
    traffic: Traffic | None = None


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A plan with its light; `light_lux` has a row for each stage of the plan's change, or one.

    `moving` is the plan's traffic, if it has any.
    """

    plan: Plan
    surfaces: Surfaces
    atlas: Atlas
    light_lux: NDArray[np.float32]
    sky: NDArray[np.float32]
    moving: MovingTraffic | None = None

    def at(self, time_s: float) -> tuple[Surfaces, NDArray[np.float32]]:
        """Return the surfaces and their light at a time; between two stages the light is mixed."""
        if self.moving is not None:
            return self.moving.at(time_s)
        change = self.plan.change
        if change is None:
            return self.surfaces, self.light_lux[0]
        share = change.share(time_s)
        place = share * (change.stages - 1)
        before = min(int(place), change.stages - 2)
        later = np.float32(place - before)
        light = self.light_lux[before] * (1 - later) + self.light_lux[before + 1] * later
        return surfaces(change.quads(share), self.atlas), light


def bake_world(plan: Plan) -> World:
    """Return the world of a plan, with its light from the cache or freshly baked."""

    def make() -> Arrays:
        atlas = make_atlas(plan.textures())
        stages = [bake(surfaces(quads, atlas), plan.sun, plan.rays) for quads in _stages(plan)]
        return {
            "names": np.array(atlas.names),
            "texels": atlas.texels,
            "table": atlas.table,
            "mean": atlas.mean,
            "light_lux": np.stack(stages),
            "sky": plan.sky(),
        }

    store = cached("worlds", f"{plan.key} {plan.version} {LIGHT_VERSION} {_digest(plan)}", make)
    atlas = Atlas(tuple(store["names"].tolist()), store["texels"], store["table"], store["mean"])  # type: ignore[arg-type]
    light_lux: NDArray[np.float32] = store["light_lux"]  # type: ignore[assignment]
    bodies = [] if plan.traffic is None else plan.traffic.bodies()
    seen = surfaces([*plan.quads, *bodies], atlas)
    moving = plan.traffic and set_moving(plan.traffic, seen, light_lux[0], plan.sun)
    return World(plan, seen, atlas, light_lux, store["sky"], moving)  # type: ignore[arg-type]


def _stages(plan: Plan) -> list[Sequence[Quad]]:
    """Return the quads for which light is baked."""
    if plan.traffic is not None:
        return [[*plan.quads, *plan.traffic.probes()]]
    if plan.change is None:
        return [plan.quads]
    return [plan.change.quads(k / (plan.change.stages - 1)) for k in range(plan.change.stages)]


def _digest(plan: Plan) -> str:
    """Return a hash of all geometry, materials and light, so that no stale light is ever used."""
    digest = hashlib.sha256(repr(plan.sun).encode())
    digest.update(repr(plan.rays).encode())
    for quad in chain.from_iterable(_stages(plan)):
        digest.update(quad.corners.tobytes() + quad.facing.tobytes())
        words = (quad.material, quad.texels_per_m, quad.offset, quad.cutout, quad.emitted_cd_m2)
        digest.update(repr((*words, quad.solid)).encode())
    return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class RenderedView:
    """One camera at one instant; rendered at once, blurred on demand."""

    scene: RenderedScene
    side: Side
    time_s: float
    radiance_cd_m2: NDArray[np.float32]
    grey_cd_m2: NDArray[np.float32]
    depth_m: NDArray[np.float32]

    def exposed(self, exposure_us: float) -> NDArray[np.float32]:
        """Return the mean radiance over an exposure that starts now, H x W, cd/m2."""
        pieces = max(1, math.ceil(exposure_us / _STRAIGHT_US))
        times_s = self.time_s + np.linspace(0.0, exposure_us * 1e-6, pieces + 1)
        poses = [self.scene.pose(self.side, float(time_s)) for time_s in times_s]
        lens = self.scene.intrinsics(self.side)
        return flow_blur(self.radiance_cd_m2, self.grey_cd_m2, self.depth_m, lens, poses)

    def exposed_exactly(self, exposure_us: float, moments: int) -> NDArray[np.float32]:
        """Return the same by rendering `moments` instants of the exposure: slow, for comparison."""
        total = np.zeros(self.radiance_cd_m2.shape)
        for k in range(moments):
            share = (k + 0.5) / moments
            total += self.scene.rendered(self.side, self.time_s + share * exposure_us * 1e-6)[0]
        return (total / moments).astype(np.float32)

    @cached_property
    def light_cd_m2(self) -> float:
        """Return the mean radiance of the view."""
        return float(self.radiance_cd_m2.mean(dtype=np.float64))


_ROS_FROM_WORLD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""From the left-handed frame of the renderer to that of REP 103: x forward, y left, z up."""


@dataclass(frozen=True, eq=False)
class RenderedScene:
    """A `Scene`: a world, looked at by two cameras with pictures of one size.

    The last few views are remembered, because a camera and the truth ask for the same one.
    """

    world: World
    lens: Intrinsics
    _views: dict[tuple[Side, float], RenderedView] = field(default_factory=dict)

    @property
    def world_version(self) -> str:
        """Return the version of the world family that makes the radiances."""
        return self.world.plan.version

    @property
    def drive_s(self) -> float:
        """Return how long the drive takes, seconds."""
        return self.world.plan.drive_s

    def intrinsics(self, side: Side) -> Intrinsics:
        """Return the pinhole intrinsics; both cameras are alike."""
        return self.lens

    def pose(self, side: Side, time_s: float) -> Pose:
        """Return where one camera is."""
        drive = self.world.plan.drive
        return drive.pose(time_s) if side == "primary" else drive.secondary_pose(time_s)

    def view(self, side: Side, time_s: float) -> RenderedView:
        """Return what one camera sees `time_s` seconds after the start of the drive."""
        key = (side, time_s)
        if key not in self._views:
            while len(self._views) >= _REMEMBERED_VIEWS:
                self._views.pop(next(iter(self._views)), None)
            self._views[key] = RenderedView(self, side, time_s, *self.rendered(side, time_s))
        return self._views[key]

    def grey_cd_m2(self, side: Side, time_s: float) -> NDArray[np.float32]:
        """Return the radiance of a view over all channels: R/4 + G/2 + B/4, H x W, cd/m2."""
        return self.view(side, time_s).grey_cd_m2

    def ground_lux(self, time_s: float) -> float:
        """Return the illuminance of the ground under the primary camera; 0 without ground."""
        eye = self.pose("primary", time_s).centre
        seen, light_lux = self.world.at(time_s)
        return float(np.mean([_lux_under(seen, light_lux, eye + step) for step in _AROUND_M]))

    def rendered(
        self, side: Side, time_s: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Return the radiance, the same in grey, and the depth of one camera at one instant."""
        seen, light_lux = self.world.at(time_s)
        atlas, sky = self.world.atlas, self.world.sky
        return render(seen, atlas, light_lux, sky, self.lens, self.pose(side, time_s))

    def truth(self, time_s: float) -> Truth:
        """Return where the primary camera is and how bright its view is."""
        pose = self.pose("primary", time_s)
        x, y, z = (float(v) for v in _ROS_FROM_WORLD @ pose.centre)
        optical = Rotation.from_matrix(_ROS_FROM_WORLD @ pose.rotation.T)
        qx, qy, qz, qw = (float(v) for v in optical.as_quat())
        return Truth((x, y, z), (qx, qy, qz, qw), self.view("primary", time_s).light_cd_m2)


_AROUND_M = np.array([[0, 0, 0], [0.8, 0, 0], [-0.8, 0, 0], [0, 0, 0.8], [0, 0, -0.8]])
"""Places about the size of a dashboard, to look for ground under."""


def _lux_under(w: Surfaces, light_lux: NDArray[np.float32], above: Vector) -> float:
    """Return the illuminance of the highest level surface that lies under a point; 0 without."""
    away = above - w.origin
    a, b = (
        (away * axis).sum(1) / np.maximum((axis * axis).sum(1), 1e-12)
        for axis in (w.along_a, w.along_b)
    )
    below = w.solid & (w.normal[:, 1] > 0.9) & (w.origin[:, 1] < above[1])
    inside = np.flatnonzero(below & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1))
    if not inside.size:
        return 0.0
    quad = inside[np.argmax(w.origin[inside, 1])]
    offset, wide, high = (int(v) for v in w.light_table[quad])
    column, row = int(a[quad] * (wide - 1) + 0.5), int(b[quad] * (high - 1) + 0.5)
    return float(light_lux[offset + row * wide + column])


def lens_for(width_px: int, height_px: int) -> Intrinsics:
    """Return the intrinsics that keep the field of view at any picture size."""
    f = _FX_PER_WIDTH * width_px
    return Intrinsics(width_px, height_px, f, f, (width_px - 1) / 2, (height_px - 1) / 2)
