"""The road's centreline and the way a vehicle shakes along it.

World frame: x right, y up, z along the road at its start, metres. A camera pose is the rotation
from the world into the optical frame (x right, y down, z forward) and the camera's centre.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

_STEP_M = 0.25
_BASELINE_M = 0.0392
"""Distance between the two cameras (thesis 3.1)."""
_SHAKING_HZ = 5.0
"""A vehicle's body moves at 1 to 2 Hz; wheels and mounts shake above this."""


class Bend(NamedTuple):
    """A stretch of constant curvature (1/m, positive to the right), eased in and out."""

    start_m: float
    length_m: float
    curvature_per_m: float


class Path:
    """A flat centreline by arc length, with the straight prolonged on both ends."""

    def __init__(self, bends: Sequence[Bend], length_m: float, ease_m: float = 6.0) -> None:
        self._s_m = np.arange(0.0, length_m + _STEP_M, _STEP_M)
        curvature = sum(
            (
                b.curvature_per_m * _plateau(self._s_m - b.start_m, b.length_m, ease_m)
                for b in bends
            ),
            start=np.zeros_like(self._s_m),
        )
        self._heading_rad = _integral(curvature)
        self._x_m = _integral(np.sin(self._heading_rad))
        self._z_m = _integral(np.cos(self._heading_rad))

    def heading_rad(self, s_m: float) -> float:
        """Return the angle from z towards x at arc length `s_m`."""
        return float(np.interp(s_m, self._s_m, self._heading_rad))

    def right(self, s_m: float) -> Vector:
        """Return the unit vector to the right of the road."""
        heading = self.heading_rad(s_m)
        return np.array([math.cos(heading), 0.0, -math.sin(heading)])

    def ahead(self, s_m: float) -> Vector:
        """Return the unit vector along the road."""
        heading = self.heading_rad(s_m)
        return np.array([math.sin(heading), 0.0, math.cos(heading)])

    def at(self, s_m: float, right_m: float = 0.0, up_m: float = 0.0) -> Vector:
        """Return the world point at arc length `s_m`, `right_m` of the centreline."""
        inside = min(max(s_m, 0.0), float(self._s_m[-1]))
        x = float(np.interp(inside, self._s_m, self._x_m))
        z = float(np.interp(inside, self._s_m, self._z_m))
        centre = np.array([x, up_m, z]) + (s_m - inside) * self.ahead(inside)
        return centre + right_m * self.right(s_m)


def _plateau(s_m: Vector, length_m: float, ease_m: float) -> Vector:
    rise = np.clip(s_m / ease_m, 0.0, 1.0)
    fall = np.clip((length_m - s_m) / ease_m, 0.0, 1.0)
    edge = np.minimum(rise, fall)
    return np.asarray(edge * edge * (3.0 - 2.0 * edge))


def _integral(rate: Vector) -> Vector:
    return np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) * (0.5 * _STEP_M))])


class Wave(NamedTuple):
    """One sine of a shaking vehicle; the unit of `amplitude` is that of what it moves."""

    amplitude: float
    frequency_hz: float
    phase_rad: float

    def at(self, time_s: float) -> float:
        """Return the displacement at a time."""
        return self.amplitude * math.sin(2 * math.pi * self.frequency_hz * time_s + self.phase_rad)


class Pose(NamedTuple):
    """`rotation` 3 x 3 from world to optical frame, `centre` of the camera in the world, metres."""

    rotation: Vector
    centre: Vector


class Knot(NamedTuple):
    """A share of the usual speed or shaking at one arc length; it changes evenly to the next."""

    s_m: float
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class Timetable:
    """When a vehicle passes which arc length: `time_s` rises, `s_m` never falls."""

    time_s: Vector
    s_m: Vector

    def at(self, time_s: float) -> float:
        """Return the arc length at a time; the vehicle stands before and after the drive."""
        return float(np.interp(time_s, self.time_s, self.s_m))


class Stop(NamedTuple):
    """Where a vehicle stands and for how long."""

    s_m: float
    wait_s: float


def paced(
    speed_mps: float, shares: Sequence[Knot], length_m: float, stops: Sequence[Stop] = ()
) -> Timetable:
    """Return when a vehicle that keeps to shares (above 0) of a speed, and stops, gets where."""
    s_m = np.arange(0.0, length_m + _STEP_M, _STEP_M)
    slowness = 1.0 / (speed_mps * np.interp(s_m, *np.array(shares).T))
    time_s = _integral(slowness)
    for stop in stops:
        at = int(np.searchsorted(s_m, stop.s_m))
        arrival_s = float(np.interp(stop.s_m, s_m, time_s))
        s_m = np.insert(s_m, at, (stop.s_m, stop.s_m))
        after = time_s[at:] + stop.wait_s
        time_s = np.concatenate([time_s[:at], (arrival_s, arrival_s + stop.wait_s), after])
    return Timetable(time_s, s_m)


@dataclass(frozen=True, slots=True)
class Drive:
    """A way along a path, with weave, bounce and vibration, as a function of time.

    The speed is `speed_mps` throughout, or what `timetable` says. The road makes the vehicle
    move, so a slower vehicle moves more slowly and a standing one not at all. `roughness` tells
    how much of the shaking of wheels and mount each place of the road gives; all of it without.
    """

    path: Path
    speed_mps: float
    lane_m: float
    height_m: float
    start_m: float
    right: tuple[Wave, ...]
    up: tuple[Wave, ...]
    yaw: tuple[Wave, ...]
    pitch: tuple[Wave, ...]
    roll: tuple[Wave, ...]
    roughness: tuple[Knot, ...] = ()
    timetable: Timetable | None = None

    def pose(self, time_s: float, right_m: float = 0.0) -> Pose:
        """Return the pose of a camera mounted `right_m` to the right of the primary."""
        s_m, rolling_s = self._progress(time_s)
        share = self._share(s_m)
        right, up, yaw, pitch, roll = (
            _sum(waves, rolling_s, share)
            for waves in (self.right, self.up, self.yaw, self.pitch, self.roll)
        )
        rotation = _optical_from_world(self.path.heading_rad(s_m) + yaw, pitch, roll)
        centre = self.path.at(s_m, self.lane_m + right, self.height_m + up)
        return Pose(rotation, centre + right_m * rotation[0])

    def _progress(self, time_s: float) -> tuple[float, float]:
        """Return the arc length, and how long it takes to get there at `speed_mps`."""
        if self.timetable is None:
            return self.start_m + self.speed_mps * time_s, time_s
        s_m = self.timetable.at(time_s)
        return s_m, (s_m - self.start_m) / self.speed_mps

    def _share(self, s_m: float) -> float:
        if not self.roughness:
            return 1.0
        return float(np.interp(s_m, *np.array(self.roughness).T))

    def secondary_pose(self, time_s: float) -> Pose:
        """Return the pose of the secondary camera, 3.92 cm right of the primary."""
        return self.pose(time_s, _BASELINE_M)


def _sum(waves: tuple[Wave, ...], time_s: float, share: float) -> float:
    """Add waves up, only a share of those that are shaking and not the body's own motion."""
    return math.fsum(
        wave.at(time_s) * (share if wave.frequency_hz > _SHAKING_HZ else 1.0) for wave in waves
    )


def _optical_from_world(yaw: float, pitch: float, roll: float) -> Vector:
    """Yaw to the right, then pitch up, then roll clockwise, all in radians."""
    cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (math.cos, math.sin))
    turn = np.array([[cy, 0.0, -sy], [0.0, 1.0, 0.0], [sy, 0.0, cy]])
    flip = np.diag([1.0, -1.0, 1.0])
    nod = np.array([[1.0, 0.0, 0.0], [0.0, cp, sp], [0.0, -sp, cp]])
    lean = np.array([[cr, sr, 0.0], [-sr, cr, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(lean @ nod @ flip @ turn)
