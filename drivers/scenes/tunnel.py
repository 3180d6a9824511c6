"""The world family `tunnel`: a bright street, a bent underpass, a bright street.

Arc length 0 is where the drive begins. Lengths are metres, offsets from the centreline positive
to the right; the vehicle keeps to the right lane.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rig.drivers.scenes.geometry import Assembly, Colour, Material, Quad
from rig.drivers.scenes.light import Sunlight
from rig.drivers.scenes.sky import cloudy_sky, mean_radiance_cd_m2
from rig.drivers.scenes.textures import street_textures
from rig.drivers.scenes.trajectories import Bend, Drive, Path, Wave
from rig.drivers.scenes.world import Plan

TUNNEL_VERSION = "tunnel/5"

_DRIVE_M = 12.0 * 13.9
_BEHIND_M = 40.0
_SEEN_AHEAD_M = 110.0
_ROAD_HALF_M = 4.2
_WALL_M = _ROAD_HALF_M + 0.7
_CEILING_M = 5.0
_BAY_M = 5.0
_DIVIDER_M = -0.15
_PLAZA_M = 95.0
_LAMP_ROWS_M = (1.15, 3.6)
_LANE_M = 1.9
_CAMERA_HEIGHT_M = 1.4


@dataclass(frozen=True, slots=True)
class Layout:
    """The numbers that a seed draws; radiances in cd/m2, illuminance in lux."""

    entrance_m: float
    exit_m: float
    bends: tuple[Bend, ...]
    sun_azimuth_rad: float
    sun_elevation_rad: float
    sun_lux: float
    sky_cd_m2: float
    cloud: float
    lamp_cd_m2: float
    lamp_step_m: float


def world_rng(name: str, split: str, seed: int, part: str) -> np.random.Generator:
    """Return the random numbers of one part of one world; no two worlds share any."""
    words = [zlib.crc32(text.encode()) for text in (name, split, part)]
    return np.random.default_rng([*words, seed])


def draw_layout(rng: np.random.Generator) -> Layout:
    """Return the layout of one world; the exit never stays in view from the entrance."""
    entrance = rng.uniform(37.0, 46.0)
    exit_ = entrance + rng.uniform(75.0, 82.0)
    radius_m = rng.uniform(48.0, 60.0)
    turn = rng.choice([-1.0, 1.0]) / radius_m
    start = entrance + rng.uniform(-4.0, 2.0)
    bends = (Bend(start, exit_ - start + rng.uniform(0.0, 6.0), turn),)
    heading = turn * bends[0].length_m
    return Layout(
        entrance_m=entrance,
        exit_m=exit_,
        bends=bends,
        sun_azimuth_rad=heading + math.pi + math.radians(rng.uniform(-40.0, 40.0)),
        sun_elevation_rad=math.radians(rng.uniform(40.0, 55.0)),
        sun_lux=rng.uniform(9e4, 1.05e5),
        sky_cd_m2=rng.uniform(4000.0, 6500.0),
        cloud=rng.uniform(0.05, 0.5),
        lamp_cd_m2=float(np.exp(rng.uniform(math.log(160e3), math.log(180e3)))),
        lamp_step_m=rng.uniform(5.0, 7.0),
    )


def tunnel(seed: int, split: str, speed_mps: float) -> Plan:
    """Return the plan of one tunnel world with a drive through it."""

    def rng(part: str) -> np.random.Generator:
        return world_rng("tunnel", split, seed, part)

    layout = draw_layout(rng("layout"))
    path = Path(layout.bends, _BEHIND_M + _DRIVE_M + _SEEN_AHEAD_M)
    street = _Street(layout, path, rng("objects"))
    sky = cloudy_sky(rng("sky"), layout.sky_cd_m2, layout.cloud)
    rise = math.sin(layout.sun_elevation_rad)
    level = math.cos(layout.sun_elevation_rad)
    towards = np.array(
        [level * math.sin(layout.sun_azimuth_rad), rise, level * math.cos(layout.sun_azimuth_rad)]
    )
    return Plan(
        key=f"tunnel {split} {seed}",
        version=TUNNEL_VERSION,
        quads=street.build(),
        textures=lambda: street_textures(rng("textures")),
        sky=lambda: sky,
        sun=Sunlight(towards, layout.sun_lux, mean_radiance_cd_m2(sky), float(sky[1, -1].mean())),
        drive=_drive(rng("motion"), path, speed_mps),
        drive_s=_DRIVE_M / speed_mps,
    )


def _drive(rng: np.random.Generator, path: Path, speed_mps: float) -> Drive:
    def wave(amplitude: float, frequency_hz: float) -> Wave:
        jitter = rng.uniform(0.85, 1.15)
        return Wave(amplitude, frequency_hz * jitter, rng.uniform(0, 2 * math.pi))

    return Drive(
        path=path,
        speed_mps=speed_mps,
        lane_m=_LANE_M,
        height_m=_CAMERA_HEIGHT_M,
        start_m=0.0,
        right=(wave(0.2, 0.08),),
        up=(wave(0.012, 1.4),),
        yaw=(wave(0.010, 0.15), wave(0.0009, 9.0), wave(0.0008, 15.0)),
        pitch=(wave(0.004, 1.4), wave(0.001, 11.0), wave(0.0012, 13.0), wave(0.0005, 24.0)),
        roll=(wave(0.003, 0.8), wave(0.0008, 11.0)),
    )


_ASPHALT = Material("asphalt", (5.0, 5.0), (1.0, 0.98, 0.95), 0.11)
_CONCRETE = Material("concrete", (5.0, 5.0), (1.0, 0.97, 0.9), 0.13)
_LIGHT_CONCRETE = Material("concrete", (4.0, 4.0), (1.5, 1.45, 1.35), 0.17)
_SLABS = Material("concrete", (5.0, 5.0), (1.1, 1.08, 1.02), 0.13)
_PAVERS = Material("pavers", (2.4, 2.4), (1.0, 0.96, 0.9), 0.17)
_BRICK = Material("brick", (1.6, 1.6), (1.35, 0.85, 0.65), 0.09)
_GRASS = Material("grass", (2.6, 2.6), (0.8, 1.15, 0.4), 0.07)
_PAINT = Material("paint", (1.0, 1.0), (1.0, 1.0, 1.0), 0.3)
_WORN_PAINT = Material("paint", (1.0, 1.0), (0.6, 0.6, 0.6), 0.3)
_METAL = Material("metal", (2.0, 2.0), (1.0, 1.0, 1.0), 0.2)
_DARK = Material("dark", (1.5, 1.5))
_LAMP = Material("blank", (1.0, 1.0), (1.1, 1.0, 0.8))
_FOLIAGE = Material("foliage", None, (0.75, 1.15, 0.4))


class _Street:
    """Places everything that stands along one path."""

    def __init__(self, layout: Layout, path: Path, rng: np.random.Generator) -> None:
        self._layout = layout
        self._path = path
        self._rng = rng
        self._put = Assembly(rng)
        self._end_m = _DRIVE_M + _SEEN_AHEAD_M

    def build(self) -> list[Quad]:
        self._ground()
        self._bore()
        self._lamps()
        self._portals()
        for side in (-1.0, 1.0):
            self._houses(side)
            self._roadside(side)
        self._far_side()
        self._inside_objects()
        return self._put.quads

    def _covered(self, s_m: float) -> bool:
        return self._layout.entrance_m <= s_m < self._layout.exit_m

    def _on_plaza(self, s_m: float) -> bool:
        return s_m >= self._layout.exit_m

    def _bays(self) -> list[tuple[float, float]]:
        """Return the stretches that the road is built from, cut at both portals."""
        cuts = np.concatenate(
            [
                np.arange(-_BEHIND_M, self._layout.entrance_m - 0.5, _BAY_M),
                np.arange(self._layout.entrance_m, self._layout.exit_m - 0.5, _BAY_M),
                np.arange(self._layout.exit_m, self._end_m, _BAY_M),
            ]
        )
        return [(float(a), float(b)) for a, b in pairwise(cuts)]

    def _ground(self) -> None:
        put, path, rng = self._put, self._path, self._rng
        for along in self._bays():
            inside = self._covered(along[0])
            road = _SLABS if self._on_plaza(along[0]) else _ASPHALT
            put.floor(path, along, (-_ROAD_HALF_M, _ROAD_HALF_M), 0.0, road, 2.0)
            dash = (along[0], along[0] + 2.2)
            paint = _WORN_PAINT if inside else _PAINT
            put.floor(path, dash, (-0.07, 0.07), 0.012, paint, solid=False)
            for side in (-1.0, 1.0):
                kerb = side * _ROAD_HALF_M
                verge = side * (_WALL_M if inside else _ROAD_HALF_M + 3.0)
                put.floor(path, along, (kerb, verge), 0.15, _PAVERS, 1.5)
                put.wall(path, along, kerb, (0.0, 0.15), _CONCRETE, 1.0)
                edge = (side * (_ROAD_HALF_M - 0.35), side * (_ROAD_HALF_M - 0.2))
                put.floor(path, along, edge, 0.012, paint, solid=False)
                if not inside:
                    ground = _LIGHT_CONCRETE if self._on_plaza(along[0]) else _GRASS
                    put.floor(path, along, (verge, side * 60.0), 0.1, ground, 0.4)
            if rng.random() < 0.55 and not self._on_plaza(along[0]):
                at, across = along[0] + rng.uniform(0, 3.5), rng.uniform(-3.8, 2.2)
                size = rng.uniform(0.4, 2.0, 2)
                patch = _DARK if rng.random() < 0.6 else _METAL
                put.floor(
                    path, (at, at + size[0]), (across, across + size[1]), 0.008, patch, solid=False
                )

    def _bore(self) -> None:
        """Build the walls, the ceiling, the pillars and the beams of the underpass."""
        put, path = self._put, self._path
        for index, along in enumerate(a for a in self._bays() if self._covered(a[0])):
            put.floor(path, along, (-_WALL_M, _WALL_M), _CEILING_M, _CONCRETE, underside=True)
            put.wall(path, along, _DIVIDER_M, (0.0, _CEILING_M), _CONCRETE, 1.5)
            for side in (-1.0, 1.0):
                put.wall(path, along, side * _WALL_M, (0.0, _CEILING_M), _CONCRETE, 1.5)
                if index % 2:
                    face = sorted((side * (_WALL_M - 0.45), side * (_WALL_M + 0.05)))
                    post, up = (along[0] + 2.2, along[0] + 2.8), (0.0, _CEILING_M + 0.02)
                    put.box(path, post, (face[0], face[1]), up, _CONCRETE, 2.0)
            if index % 2:
                up = (_CEILING_M - 0.45, _CEILING_M)
                put.gate(path, along[0] + 2.2, (-_WALL_M, _WALL_M), up, _METAL)

    def _lamps(self) -> None:
        """Hang two rows of lamps in each tube."""
        lay = self._layout
        for s_m in np.arange(lay.entrance_m + 4.0, lay.exit_m - 3.0, lay.lamp_step_m):
            for across in _LAMP_ROWS_M:
                for side in (-1.0, 1.0):
                    self._lamp(float(s_m), side * across, lay.lamp_cd_m2)

    def _lamp(self, s_m: float, across: float, radiance_cd_m2: float) -> None:
        """Hang one lamp in a housing whose sides keep its light out of drivers' eyes."""
        put, path = self._put, self._path
        along, wide = (s_m, s_m + 1.3), (across - 0.25, across + 0.25)
        rim = (_CEILING_M - 0.5, _CEILING_M)
        put.floor(
            path,
            along,
            wide,
            _CEILING_M - 0.06,
            _LAMP,
            underside=True,
            emitted_cd_m2=radiance_cd_m2,
        )
        for end, towards in ((along[0], -1.0), (along[1], 1.0)):
            put.gate(path, end, wide, rim, _DARK, towards=towards)
        for edge in wide:
            corners = [
                path.at(s, edge, h) for h in rim for s in (along if h == rim[0] else along[::-1])
            ]
            put.quad(corners, math.copysign(1.0, edge - across) * path.right(s_m), _DARK)

    def _portals(self) -> None:
        put, path = self._put, self._path
        for s_m, towards in ((self._layout.entrance_m, -1.0), (self._layout.exit_m, 1.0)):
            for side in (-1.0, 1.0):
                across = (side * _WALL_M, side * (_WALL_M + 40.0))
                put.gate(path, s_m, across, (0.0, 8.0), _BRICK, 0.8, towards=towards)
            lintel = (-_WALL_M, _WALL_M)
            put.gate(path, s_m, lintel, (_CEILING_M, 8.0), _CONCRETE, 1.5, towards=towards)
            name = Material(f"sign{self._rng.integers(6)}", None)
            put.gate(
                path,
                s_m + 0.03 * towards,
                (-2.2, 2.2),
                (5.8, 7.0),
                name,
                2.0,
                towards=towards,
                solid=False,
            )
        for along in self._bays():
            if self._covered(along[0]):
                put.floor(path, along, (-45.0, 45.0), 8.0, _GRASS, 0.3)

    def _houses(self, side: float) -> None:
        put, path, rng, lay = self._put, self._path, self._rng, self._layout
        s_m = -_BEHIND_M
        while s_m < lay.entrance_m:
            length, high = rng.uniform(8.0, 17.0), rng.uniform(6.0, 18.0)
            near = _ROAD_HALF_M + 3.2 + rng.uniform(0.0, 4.0)
            across = sorted((side * near, side * (near + 12.0)))
            if s_m + length < lay.entrance_m - 1.0:
                tile = (rng.uniform(6.0, 10.0), rng.uniform(6.0, 9.0))
                wall = Material(f"facade{rng.integers(4)}", tile, self._colour(), 0.08)
                put.box(
                    path,
                    (s_m, s_m + length),
                    (across[0], across[1]),
                    (0.1, high),
                    wall,
                    1.2,
                    top=_DARK,
                )
            s_m += length + rng.uniform(0.5, 8.0)

    def _far_side(self) -> None:
        """Close the plaza with a row of houses that look back at the tunnel."""
        put, path, rng = self._put, self._path, self._rng
        near, across = self._layout.exit_m + _PLAZA_M, -70.0
        while across < 70.0:
            wide, high = rng.uniform(10.0, 20.0), rng.uniform(9.0, 20.0)
            tile = (rng.uniform(6.0, 10.0), rng.uniform(6.0, 9.0))
            front = Material(f"facade{rng.integers(4)}", tile, self._colour(), 0.08)
            put.box(path, (near, near + 10.0), (across, across + wide), (0.1, high), front)
            across += wide

    def _colour(self) -> Colour:
        red, green, blue = (float(v) for v in self._rng.uniform(0.85, 1.12, 3))
        return (red, green, blue)

    def _roadside(self, side: float) -> None:
        """Plant trees, poles with signs, and parked cars along both streets."""
        rng, lay = self._rng, self._layout
        s_m = -25.0
        while s_m < lay.exit_m + _PLAZA_M - 20.0:
            if s_m < lay.entrance_m - 5.0 or s_m > lay.exit_m + 4.0:
                kind = rng.random()
                if self._on_plaza(s_m):
                    self._bollard(s_m, side * (_ROAD_HALF_M + rng.uniform(0.6, 9.0)))
                elif kind < 0.4:
                    self._tree(s_m, side * (_ROAD_HALF_M + rng.uniform(1.2, 2.6)))
                elif kind < 0.7:
                    self._pole(s_m, side * (_ROAD_HALF_M + rng.uniform(0.8, 2.2)))
                else:
                    self._car(s_m, side * (_ROAD_HALF_M + 1.2))
            s_m += rng.uniform(4.5, 11.0)

    def _bollard(self, s_m: float, across: float) -> None:
        put, path, rng = self._put, self._path, self._rng
        half, high = rng.uniform(0.2, 0.9), rng.uniform(0.5, 1.1)
        span = (across - half, across + half)
        put.box(path, (s_m, s_m + 0.6), span, (0.1, high), _LIGHT_CONCRETE, 2.0)
        side, near = math.copysign(1.0, across), abs(across) + rng.uniform(6.0, 16.0)
        inner, outer = sorted((side * near, side * (near + rng.uniform(3.0, 7.0))))
        plaster = Material("brick", (1.6, 1.6), (1.9, 1.8, 1.6), 0.09)
        put.box(path, (s_m, s_m + 4.0), (inner, outer), (0.1, rng.uniform(2.4, 4.0)), plaster)

    def _tree(self, s_m: float, across: float) -> None:
        put, path, rng = self._put, self._path, self._rng
        radius, base = rng.uniform(1.2, 2.2), rng.uniform(2.2, 3.2)
        for layer in range(3):
            left = across - radius + rng.uniform(-0.4, 0.4)
            up = (base + 0.2 * layer, base + 0.2 * layer + 2 * radius)
            put.gate(
                path,
                s_m + 0.5 * layer,
                (left, left + 2 * radius),
                up,
                _FOLIAGE,
                cutout="leaves",
                solid=False,
            )
        trunk = (across - 0.13, across + 0.13)
        put.box(path, (s_m, s_m + 0.26), trunk, (0.0, base + 1.0), _DARK, 2.0)

    def _pole(self, s_m: float, across: float) -> None:
        put, path, rng = self._put, self._path, self._rng
        put.box(path, (s_m, s_m + 0.12), (across - 0.06, across + 0.06), (0.0, 6.0), _METAL)
        plate = Material(f"sign{rng.integers(6)}", None, self._colour())
        low = rng.uniform(2.0, 3.0)
        put.gate(
            path,
            s_m - 0.04,
            (across - 0.5, across + 0.5),
            (low, low + 1.0),
            plate,
            2.0,
            solid=False,
        )

    def _car(self, s_m: float, across: float) -> None:
        rng = self._rng
        body = Material(f"car{rng.integers(3)}", None, self._colour())
        self._put.box(
            self._path,
            (s_m, s_m + 4.2),
            (across - 0.9, across + 0.9),
            (0.25, 1.5),
            body,
            2.0,
            top=_METAL,
        )

    def _inside_objects(self) -> None:
        """Hang signs and cabinets on the walls and leave a van in the other tube."""
        put, path, rng, lay = self._put, self._path, self._rng, self._layout
        for s_m in np.arange(lay.entrance_m + 2.0, lay.exit_m - 3.0, 4.0):
            side = float(rng.choice([-1.0, 1.0]))
            low, wide = rng.uniform(0.8, 2.2), rng.uniform(0.6, 1.6)
            plate = Material(f"sign{rng.integers(6)}", None, self._colour())
            start = float(s_m + rng.uniform(0.0, 1.5))
            put.wall(
                path,
                (start, start + wide),
                side * (_WALL_M - 0.03),
                (low, low + 1.2),
                plate,
                2.0,
                solid=False,
            )
        at = rng.uniform(lay.entrance_m + 8.0, lay.exit_m - 12.0)
        van = Material(f"car{rng.integers(3)}", None, self._colour())
        put.box(path, (at, at + 5.0), (-3.9, -2.0), (0.3, 2.4), van, 2.0, top=_METAL)
