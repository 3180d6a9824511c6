"""Vehicles that drive while the world is looked at: boxes with light that was baked on their lanes.

For every lane, light is baked on a box that stands at evenly spaced places along it. A vehicle gets
the light of the two places around it, mixed, and keeps light off the ground beside and beneath it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from rig.drivers.scenes import materials
from rig.drivers.scenes.geometry import Assembly, Material, Quad, Surfaces
from rig.drivers.scenes.light import Sunlight
from rig.drivers.scenes.trajectories import Path, Vector

Floats = NDArray[np.float32]

_STATION_M = 4.0
_TEXELS_PER_M = 0.3
"""So coarse that each side of each vehicle has the fewest texels there are, two by two."""
_BODY_TEXELS = 5 * 4
_SHADOW_REACH_M = 6.0
_GROUND_M = 0.3
_SHADED_SKY = 0.7
"""The share of the open sky that is left beside a vehicle in a street."""
_BENEATH = 0.3
"""The share of light that is left beneath a vehicle."""


class Lane(NamedTuple):
    """A lane of a loop of `length_m`; driven along its path (`towards` 1) or against it (-1)."""

    path: Path
    length_m: float
    across_m: float
    towards: float

    @property
    def stations(self) -> int:
        """Return at how many places its light is baked."""
        return math.ceil(self.length_m / _STATION_M)

    def frame(self, driven_m: float) -> Frame:
        """Return the frame of a vehicle that has driven so far from the loop's start."""
        s_m = self.towards * driven_m % self.length_m
        right, ahead = (self.towards * f(s_m) for f in (self.path.right, self.path.ahead))
        return Frame(self.path.at(s_m, self.across_m), np.stack([right, [0.0, 1.0, 0.0], ahead]))


class Frame(NamedTuple):
    """Where a vehicle stands, and its axes in the world: the rows are right, up and ahead."""

    place: Vector
    axes: Vector

    def outside(self, points: Vector) -> Vector:
        """Return points of the vehicle, ... x 3, in the world."""
        return np.asarray(points @ self.axes + self.place)

    def inside(self, points: Vector) -> Vector:
        """Return points of the world, ... x 3, in the vehicle's frame."""
        return np.asarray((points - self.place) @ self.axes.T)


class Size(NamedTuple):
    """A box: length, width, and heights of its lower and upper side, metres."""

    length_m: float
    width_m: float
    low_m: float
    high_m: float


CAR = Size(4.2, 1.8, 0.02, 1.5)
VAN = Size(5.0, 1.9, 0.02, 2.4)


@dataclass(frozen=True, slots=True, eq=False)
class Vehicle:
    """A vehicle in the lane of that number; `driven_m` is how far it has driven at a time."""

    lane: int
    size: Size
    body: Sequence[Quad]
    driven_m: Callable[[float], float]


@dataclass(frozen=True, slots=True, eq=False)
class Traffic:
    """Lanes of one length and the vehicles that drive on them."""

    lanes: tuple[Lane, ...]
    vehicles: tuple[Vehicle, ...]

    def bodies(self) -> list[Quad]:
        """Return the quads of all vehicles, each in its own frame."""
        return [quad for vehicle in self.vehicles for quad in vehicle.body]

    def probes(self) -> list[Quad]:
        """Return the boxes on which light is baked, lane after lane; they block none."""
        body = box_body(np.random.default_rng(0), CAR, materials.METAL, materials.METAL)
        return [
            replace(
                quad,
                corners=frame.outside(quad.corners),
                facing=quad.facing @ frame.axes,
                solid=False,
            )
            for lane in self.lanes
            for frame in map(lane.frame, _station_places(lane))
            for quad in body
        ]


def _station_places(lane: Lane) -> list[float]:
    return [float(m) for m in np.linspace(0.0, lane.length_m, lane.stations, endpoint=False)]


def box_body(rng: np.random.Generator, size: Size, sides: Material, ends: Material) -> list[Quad]:
    """Return the ends, sides and lid of a box around its own middle, x to the right, z ahead."""
    put = Assembly(rng)
    along, across = ((-0.5 * m, 0.5 * m) for m in (size.length_m, size.width_m))
    up = (size.low_m, size.high_m)
    put.box(Path((), 1.0), along, across, up, sides, _TEXELS_PER_M, top=materials.METAL, ends=ends)
    return put.quads


@dataclass(frozen=True, slots=True, eq=False)
class MovingTraffic:
    """Traffic in a world whose last surfaces are its vehicles, each in its own frame.

    `lane_lux` is lanes x stations x texels of a body. `ground` holds the places of the texels that
    vehicles cast shadows on, `ground_texels` their numbers.
    """

    traffic: Traffic
    surfaces: Surfaces
    light_lux: Floats
    lane_lux: Floats
    sun: Sunlight
    ground: KDTree
    ground_texels: NDArray[np.int64]

    def at(self, time_s: float) -> tuple[Surfaces, Floats]:
        """Return the surfaces and their light at a time."""
        vehicles = self.traffic.vehicles
        driven = [vehicle.driven_m(time_s) for vehicle in vehicles]
        lanes = [self.traffic.lanes[vehicle.lane] for vehicle in vehicles]
        frames = [lane.frame(m) for lane, m in zip(lanes, driven, strict=True)]
        still = self.light_lux.copy()
        for vehicle, frame in zip(vehicles, frames, strict=True):
            self._cast_shadow(vehicle.size, frame, still)
        bodies = [self._body_lux(v.lane, m) for v, m in zip(vehicles, driven, strict=True)]
        return self._placed(frames), np.concatenate([still, *bodies])

    def _placed(self, frames: Sequence[Frame]) -> Surfaces:
        seen = self.surfaces
        copies = [a.copy() for a in (seen.corners, seen.along_a, seen.along_b, seen.normal)]
        corners, *directions = copies
        first = len(corners) - len(self.traffic.bodies())
        for vehicle, frame in zip(self.traffic.vehicles, frames, strict=True):
            own = slice(first, first + len(vehicle.body))
            corners[own] = frame.outside(corners[own])
            for direction in directions:
                direction[own] = direction[own] @ frame.axes
            first = own.stop
        along_a, along_b, normal = directions
        return seen._replace(
            corners=corners,
            origin=np.ascontiguousarray(corners[:, 0]),
            along_a=along_a,
            along_b=along_b,
            normal=normal,
        )

    def _body_lux(self, lane: int, driven_m: float) -> Floats:
        lux = self.lane_lux[lane]
        place = driven_m / self.traffic.lanes[lane].length_m * len(lux)
        before = int(place)
        later = np.float32(place - before)
        mixed = lux[before % len(lux)] * (1 - later) + lux[(before + 1) % len(lux)] * later
        return np.asarray(mixed)

    def _cast_shadow(self, size: Size, frame: Frame, light_lux: Floats) -> None:
        near = np.array(self.ground.query_ball_point(frame.place, _SHADOW_REACH_M), np.int64)
        texels = self.ground_texels[near]
        points = frame.inside(self.ground.data[near])
        box = (
            np.array([-0.5 * size.width_m, size.low_m, -0.5 * size.length_m]),
            np.array([0.5 * size.width_m, size.high_m, 0.5 * size.length_m]),
        )
        dark = _meets(points, frame.axes @ self.sun.towards, box)
        shade_lux = np.float32(_SHADED_SKY * math.pi * self.sun.sky_cd_m2)
        light_lux[texels[dark]] = np.minimum(light_lux[texels[dark]], shade_lux)
        light_lux[texels[_meets(points, np.array([0.0, 1.0, 0.0]), box)]] *= np.float32(_BENEATH)


def _meets(points: Vector, towards: Vector, box: tuple[Vector, Vector]) -> NDArray[np.bool_]:
    """Return from which points, n x 3, a ray in one direction meets a box that lies above them."""
    direction = np.where(np.abs(towards) < 1e-9, 1e-9, towards)
    low, high = ((side - points) / direction for side in box)
    enter, leave = np.minimum(low, high).max(1), np.maximum(low, high).min(1)
    return np.asarray(leave > np.maximum(enter, 0.0))


def set_moving(traffic: Traffic, seen: Surfaces, light_lux: Floats, sun: Sunlight) -> MovingTraffic:
    """Return traffic in a world; `light_lux` is that of all that stands, then that of the probes.

    The last quads of `seen` are the bodies of the vehicles.
    """
    first = len(seen.corners) - len(traffic.bodies())
    still = int(seen.light_table[first, 0])
    lane_lux = light_lux[still:].reshape(len(traffic.lanes), -1, _BODY_TEXELS)
    places, texels = _ground_texels(seen, first)
    tree = KDTree(places)
    return MovingTraffic(traffic, seen, light_lux[:still], lane_lux, sun, tree, texels)


def _ground_texels(seen: Surfaces, first_body: int) -> tuple[Vector, NDArray[np.int64]]:
    """Return the places and numbers of the light texels of roads, pavements and their paint."""
    level = (seen.normal[:, 1] > 0.9) & (np.abs(seen.origin[:, 1]) < _GROUND_M)
    places, texels = [], []
    for quad in np.flatnonzero(level[:first_body]):
        offset, wide, high = (int(v) for v in seen.light_table[quad])
        row, column = np.divmod(np.arange(wide * high), wide)
        a, b = ((column + 0.5) / wide)[:, None], ((row + 0.5) / high)[:, None]
        places.append(seen.origin[quad] + a * seen.along_a[quad] + b * seen.along_b[quad])
        texels.append(offset + np.arange(wide * high))
    return np.concatenate(places), np.concatenate(texels)
