"""The world family `route`: once around a block with two underpasses, four turns and three stops.

The sides of the block are numbered in the order of the drive; each ends in a right turn, and the
last one leads back to the start. The first and the third side have an underpass with an S-bend
and a light square behind it. Vehicles come towards the driver, and in some worlds one drives ahead.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.drivers.scenes import materials
from rig.drivers.scenes.geometry import Material, Quad
from rig.drivers.scenes.street import (
    LANE_M,
    ROAD_HALF_M,
    Lighting,
    Street,
    bays,
    draw_lighting,
)
from rig.drivers.scenes.textures import street_textures
from rig.drivers.scenes.traffic import CAR, VAN, Lane, Traffic, Vehicle, box_body
from rig.drivers.scenes.trajectories import Bend, Knot, Path, Stop, Timetable, paced
from rig.drivers.scenes.vehicle import shaken_drive
from rig.drivers.scenes.weather import Weather, daylight, draw_weather, world_rng
from rig.drivers.scenes.world import Plan

ROUTE_VERSION = "route/3"

_DRIVE_S = 76.0
"""Every loop at the usual speed lasts this long: the stops take what the moving leaves."""
_USUAL_MPS = 13.9
_BEYOND_M = 8.0
"""The drive ends this far behind its start, so that its last turn is over."""
_LINE_M = 6.0
_TURN_M = 14.0 * math.pi / 2 + 6.0
_TURN_PER_M = 1 / 14.0
_VERGE_M = 11.0
_LAMP_LEVEL = 0.55
_DEAD_M = ((0.0, 0.0), (14.0, 15.0))
"""Between what lengths the stretch of dead lamps of the first and the second underpass is."""
_VEIL = 0.5
"""A hazy sun: in a clear one the street asks for so little exposure that 0 dB hardly smears."""
_FRONT = ((-45.0, 0.0), (6.0, 0.0), (6.0, 14.0), (-45.0, 14.0))


@dataclass(frozen=True, slots=True)
class Side:
    """One side of the block: where it starts, its turn, and its underpass if it has one."""

    start_m: float
    turn_m: float
    entrance_m: float = math.inf
    exit_m: float = math.inf

    @property
    def end_m(self) -> float:
        """Return where the turn at its end is over."""
        return self.turn_m + _TURN_M


@dataclass(frozen=True, slots=True)
class Layout:
    """The numbers that a seed draws."""

    sides: tuple[Side, ...]
    bends: tuple[Bend, ...]
    wait_weights: tuple[float, ...]
    weather: Weather
    lightings: tuple[Lighting, ...]
    rough_outside: float
    open_share: float

    @property
    def length_m(self) -> float:
        """Return the length of the loop."""
        return self.sides[-1].end_m

    @property
    def drive_m(self) -> float:
        """Return the length of the drive: the loop and a little more."""
        return self.length_m + _BEYOND_M

    @property
    def lines_m(self) -> tuple[float, ...]:
        """Return where the lines are at which the vehicle stops."""
        return tuple(side.turn_m - _LINE_M for side in self.sides[:3])

    @property
    def stops(self) -> tuple[Stop, ...]:
        """Return where the vehicle waits for how long."""
        moving_s = float(paced(_USUAL_MPS, _pace(self, self.lines_m), self.drive_m).time_s[-1])
        per_weight_s = (_DRIVE_S - moving_s) / math.fsum(self.wait_weights)
        waits = zip(self.lines_m, self.wait_weights, strict=True)
        return tuple(Stop(line_m, weight * per_weight_s) for line_m, weight in waits)


def draw_layout(rng: np.random.Generator) -> Layout:
    """Return a closed block: its last two sides are as long as the first two ask for."""
    open_m = [rng.uniform(40.0, 50.0), rng.uniform(42.0, 50.0), rng.uniform(50.0, 60.0)]
    turn = rng.choice([-1.0, 1.0]) / rng.uniform(75.0, 90.0)
    tube_m = rng.uniform(78.0, 82.0)
    cross_m = rng.uniform(62.0, 72.0)
    lengths = [open_m[0] + tube_m + open_m[1], cross_m, open_m[2] + tube_m + 60.0, cross_m]
    entrances = (open_m[0], math.inf, open_m[2], math.inf)
    sides, bends = _block(lengths, entrances, tube_m, turn)
    end = Path(bends, sides[-1].end_m).at(sides[-1].end_m)
    lengths[2] += float(end[2])
    lengths[3] += float(end[0])
    sides, bends = _block(lengths, entrances, tube_m, turn)
    return Layout(
        sides=tuple(sides),
        bends=tuple(bends),
        wait_weights=tuple(rng.uniform(0.8, 1.25) for _ in range(3)),
        weather=draw_weather(rng, math.pi, 180.0).veiled(_VEIL),
        lightings=tuple(
            draw_lighting(rng, side.entrance_m, side.exit_m, _LAMP_LEVEL, dead_m)
            for side, dead_m in zip(_tubes(sides), _DEAD_M, strict=True)
        ),
        rough_outside=rng.uniform(4.0, 4.6),
        open_share=rng.uniform(0.92, 1.08),
    )


def _block(
    lengths_m: Sequence[float], entrances_m: Sequence[float], tube_m: float, turn: float
) -> tuple[list[Side], list[Bend]]:
    sides: list[Side] = []
    bends: list[Bend] = []
    start = 0.0
    for length, entrance in zip(lengths_m, entrances_m, strict=True):
        into = start + entrance
        side = Side(start, start + length, into, into + tube_m)
        if math.isfinite(into):
            half = 0.5 * tube_m
            bends += [Bend(into - 2.0, half, turn), Bend(into - 2.0 + half, half, -turn)]
        bends.append(Bend(side.turn_m, _TURN_M, _TURN_PER_M))
        sides.append(side)
        start = side.end_m
    return sides, bends


def route(seed: int, split: str, speed_mps: float) -> Plan:
    """Return the plan of one block with a drive around it."""

    def rng(part: str) -> np.random.Generator:
        return world_rng("route", split, seed, part)

    layout = draw_layout(rng("layout"))
    path = Path(layout.bends, layout.length_m)
    light = daylight(layout.weather, rng("sky"))
    pace = _pace(layout, layout.lines_m)
    timetable = paced(speed_mps, pace, layout.drive_m, layout.stops)
    return Plan(
        key=f"route {split} {seed}",
        version=ROUTE_VERSION,
        quads=_build(layout, Street(path, rng("objects"))),
        textures=lambda: street_textures(rng("textures")),
        sky=lambda: light.sky,
        sun=light.sun,
        drive=shaken_drive(
            rng("motion"), path, speed_mps, roughness=_roughness(layout), timetable=timetable
        ),
        drive_s=float(timetable.time_s[-1]),
        traffic=_traffic(layout, path, speed_mps, rng("traffic")),
    )


def _tubes(sides: Sequence[Side]) -> list[Side]:
    return [side for side in sides if math.isfinite(side.entrance_m)]


def _pace(layout: Layout, stops_m: Sequence[float] = ()) -> tuple[Knot, ...]:
    """Return slow turns, slower still at stops, and slowed underpasses."""
    knots: list[Knot] = []
    free = layout.open_share
    for side in layout.sides:
        if math.isfinite(side.entrance_m):
            knots += [Knot(side.entrance_m - 10.0, free), Knot(side.entrance_m, 0.6)]
            knots += [Knot(side.exit_m, 0.6), Knot(side.exit_m + 15.0, free)]
        line = side.turn_m - _LINE_M
        knots += [Knot(line - 12.0, free), Knot(line, 0.12 if line in stops_m else 0.55)]
        knots += [Knot(side.turn_m, 0.55), Knot(side.end_m, 0.55), Knot(side.end_m + 15.0, free)]
    return tuple(knots)


def _traffic(layout: Layout, path: Path, speed_mps: float, rng: np.random.Generator) -> Traffic:
    """Return two to four vehicles that come around the block, and at times one that leads.

    None of them stops, so none is caught up with: all of a lane keep to one timetable.
    """
    onward = _pace(layout)
    back = [Knot(layout.length_m - knot.s_m, knot.share) for knot in reversed(onward)]
    ahead, towards = (paced(speed_mps, pace, layout.length_m) for pace in (onward, back))
    lanes = (Lane(path, layout.length_m, LANE_M, 1.0), Lane(path, layout.length_m, -LANE_M, -1.0))
    count = int(rng.integers(2, 5))
    round_s = float(towards.time_s[-1])
    starts = [(k + rng.uniform(0.0, 0.7)) * round_s / count for k in range(count)]
    vehicles = [_vehicle(1, towards, start_s, rng) for start_s in starts]
    if rng.random() < 0.6:
        lead_s = rng.uniform(2.5, 4.0) * _USUAL_MPS / speed_mps
        vehicles.append(_vehicle(0, ahead, lead_s, rng))
    return Traffic(lanes, tuple(vehicles))


def _vehicle(lane: int, timetable: Timetable, start_s: float, rng: np.random.Generator) -> Vehicle:
    """Return a vehicle that goes around by a timetable and has begun `start_s` before the drive."""
    red, green, blue = (float(v) for v in rng.uniform(0.85, 1.12, 3))
    size = CAR if rng.random() < 0.7 else VAN
    paint = f"car{rng.integers(3)}"
    sides, ends = (Material(f"{paint}{part}", None, (red, green, blue)) for part in ("", "-end"))
    round_s = float(timetable.time_s[-1])

    def driven_m(time_s: float) -> float:
        return timetable.at((time_s + start_s) % round_s)

    return Vehicle(lane, size, box_body(rng, size, sides, ends), driven_m)


def _roughness(layout: Layout) -> tuple[Knot, ...]:
    """Return rough paving outside and smooth asphalt in the underpasses."""
    knots: list[Knot] = []
    for side in _tubes(layout.sides):
        rough, smooth = layout.rough_outside, 0.2
        knots += [Knot(side.entrance_m - 3.0, rough), Knot(side.entrance_m, smooth)]
        knots += [Knot(side.exit_m, smooth), Knot(side.exit_m + 3.0, rough)]
    return tuple(knots)


def _build(layout: Layout, street: Street) -> list[Quad]:
    for side in layout.sides:
        if math.isfinite(side.entrance_m):
            _open(street, (side.start_m, side.entrance_m))
            _underpass(street, side)
            _square(street, (side.exit_m, side.end_m))
        else:
            _open(street, (side.start_m, side.end_m))
    for lighting in layout.lightings:
        street.lamps(lighting)
    _plain(street, layout)
    return street.quads


def _open(street: Street, along: tuple[float, float]) -> None:
    """Build a street with houses, trees, and vehicles beside the road."""
    for bay in bays(*along):
        street.ground(bay, materials.STREET, _VERGE_M)
        street.patch(bay[0])
    outer, inner = (along[0] + 3.0, along[1] - 3.0), (along[0] + 3.0, along[1] - _TURN_M - 3.0)
    for side, stretch in ((-1.0, outer), (1.0, inner)):
        street.houses(stretch, side)
        street.roadside(stretch, side)


def _square(street: Street, along: tuple[float, float]) -> None:
    """Build a light square, closed by a white front beyond the turn."""
    for bay in bays(*along):
        street.ground(bay, materials.SQUARE, _VERGE_M)
    for side in (-1.0, 1.0):
        for s_m in np.arange(along[0] + 5.0, along[1] - _TURN_M - 4.0, 9.0):
            street.bollard(float(s_m), side * (ROAD_HALF_M + street.rng.uniform(0.6, 3.0)))
    turn_m = along[1] - _TURN_M
    base, right, ahead = (f(turn_m) for f in (street.path.at, street.path.right, street.path.ahead))
    up = np.array([0.0, 1.0, 0.0])
    front = [base + 27.0 * ahead + d * right + h * up for d, h in _FRONT]
    street.put.quad(front, -ahead, materials.BRIGHT)


def _underpass(street: Street, side: Side) -> None:
    for index, bay in enumerate(bays(side.entrance_m, side.exit_m)):
        street.ground(bay, materials.TUBE)
        street.patch(bay[0])
        street.tube(bay, pillars=index % 2 == 1)
        street.roof(bay, 22.0)
    street.portal(side.entrance_m, -1.0, 17.0)
    street.portal(side.exit_m, 1.0, 17.0)
    street.inner_signs(side.entrance_m + 2.0, side.exit_m - 3.0)


def _plain(street: Street, layout: Layout) -> None:
    """Lay grass between and around the streets."""
    corners = np.array([street.path.at(s) for s in np.arange(0.0, layout.length_m, 5.0)])
    low, high = corners.min(0) - 80.0, corners.max(0) + 80.0
    flat = Path((), 1.0)
    for z in np.arange(low[2], high[2], 40.0):
        for x in np.arange(low[0], high[0], 40.0):
            street.put.floor(flat, (z, z + 40.0), (x, x + 40.0), -0.03, materials.GRASS, 0.3)
