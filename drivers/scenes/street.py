"""The pieces that worlds with roads are put together from, placed along one path.

Lengths are metres, offsets from the centreline positive to the right; traffic keeps right.
"""

from __future__ import annotations

import math
from bisect import bisect
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rig.drivers.scenes import materials as m
from rig.drivers.scenes.geometry import Assembly, Colour, Material, Quad
from rig.drivers.scenes.trajectories import Path

ROAD_HALF_M = 4.2
WALL_M = ROAD_HALF_M + 0.7
CEILING_M = 5.0
ROOF_M = 8.0
LANE_M = 1.9
BAY_M = 5.0
_DIVIDER_M = -0.15
_LAMP_CD_M2 = 430e3
"""How bright the lamps of an underpass are if they hang every 6 m."""
_LAMP_SHARES = (0.97, 1.12, 0.0, 0.95)
"""How bright lamps are in the first 18 m, up to the dark stretch, in it, and behind it."""
_LAMP_ROWS_M = (1.15, 3.6)


def bays(*cuts_m: float) -> list[tuple[float, float]]:
    """Return stretches of about 5 m between the first and last cut, with a seam at each cut."""
    seams: list[float] = []
    for start, end in pairwise(cuts_m):
        count = max(1, round((end - start) / BAY_M))
        seams.extend(float(s) for s in np.linspace(start, end, count + 1)[:-1])
    seams.append(cuts_m[-1])
    return list(pairwise(seams))


class Lighting(NamedTuple):
    """The lamps of an underpass; none works between `dark_from_m` and `dark_to_m`."""

    entrance_m: float
    exit_m: float
    dark_from_m: float
    dark_to_m: float
    lamp_cd_m2: float
    lamp_step_m: float

    def share(self, s_m: float) -> float:
        """Return how bright the lamps at one place are beside `lamp_cd_m2`."""
        places = (self.entrance_m + 18.0, self.dark_from_m, self.dark_to_m)
        return _LAMP_SHARES[bisect(places, s_m)]


def draw_lighting(
    rng: np.random.Generator,
    entrance_m: float,
    exit_m: float,
    level: float = 1.0,
    dead_m: tuple[float, float] = (10.5, 11.5),
) -> Lighting:
    """Return the lamps of an underpass of about 80 m: the further apart, the brighter.

    `level` is how bright it is beside that of `tunnel`, `dead_m` from what range the length of
    the stretch is drawn whose lamps do not work.
    """
    step_m = rng.uniform(5.0, 7.0)
    dark_from_m = entrance_m + rng.uniform(44.0, 46.0)
    return Lighting(
        entrance_m=entrance_m,
        exit_m=exit_m,
        dark_from_m=dark_from_m,
        dark_to_m=dark_from_m + rng.uniform(*dead_m),
        lamp_cd_m2=level * _LAMP_CD_M2 * step_m / 6.0 * rng.uniform(0.93, 1.07),
        lamp_step_m=step_m,
    )


class Street:
    """Places the pieces of a road world along `path`; what varies is drawn from `rng`."""

    def __init__(self, path: Path, rng: np.random.Generator) -> None:
        self.path = path
        self.rng = rng
        self.put = Assembly(rng)

    @property
    def quads(self) -> list[Quad]:
        """Return everything placed so far."""
        return self.put.quads

    def ground(self, along: tuple[float, float], ground: m.Ground, verge_m: float = 60.0) -> None:
        """Lay one bay of road with its markings, kerbs, pavements and verges."""
        put, path = self.put, self.path
        pavement_m, verge_up_m = (0.0, 0.0) if ground.kerb is None else (0.15, 0.1)
        put.floor(path, along, (-ROAD_HALF_M, ROAD_HALF_M), 0.0, ground.road, 2.0)
        dash = (along[0], along[0] + 2.2)
        put.floor(path, dash, (-0.07, 0.07), 0.012, ground.paint, solid=False)
        for side in (-1.0, 1.0):
            kerb = side * ROAD_HALF_M
            border = side * (WALL_M if ground.verge is None else ROAD_HALF_M + 3.0)
            put.floor(path, along, (kerb, border), pavement_m, ground.pavement, 1.5)
            if ground.kerb is not None:
                put.wall(path, along, kerb, (0.0, 0.15), ground.kerb, 1.0)
            edge = (side * (ROAD_HALF_M - 0.35), side * (ROAD_HALF_M - 0.2))
            put.floor(path, along, edge, 0.012, ground.paint, solid=False)
            if ground.verge is not None and verge_m > ROAD_HALF_M + 3.0:
                put.floor(path, along, (border, side * verge_m), verge_up_m, ground.verge, 0.4)

    def patch(self, from_m: float) -> None:
        """Mend the road with a patch of tar or leave a manhole cover in it, at times."""
        if self.rng.random() < 0.55:
            at, across = from_m + self.rng.uniform(0, 3.5), self.rng.uniform(-3.8, 2.2)
            along, wide = self.rng.uniform(0.4, 2.0, 2)
            stuff = m.DARK if self.rng.random() < 0.6 else m.METAL
            span = (across, across + wide)
            self.put.floor(self.path, (at, at + along), span, 0.008, stuff, solid=False)

    def tube(self, along: tuple[float, float], pillars: bool) -> None:
        """Build one bay of an underpass: walls, a wall between the tubes, ceiling, earth above."""
        put, path = self.put, self.path
        put.floor(path, along, (-WALL_M, WALL_M), CEILING_M, m.CONCRETE, underside=True)
        put.wall(path, along, _DIVIDER_M, (0.0, CEILING_M), m.CONCRETE, 1.5)
        for side in (-1.0, 1.0):
            put.wall(path, along, side * WALL_M, (0.0, CEILING_M), m.CONCRETE, 1.5)
            if pillars:
                face = sorted((side * (WALL_M - 0.45), side * (WALL_M + 0.05)))
                post, up = (along[0] + 2.2, along[0] + 2.8), (0.0, CEILING_M + 0.02)
                put.box(path, post, (face[0], face[1]), up, m.CONCRETE, 2.0)
        if pillars:
            up = (CEILING_M - 0.45, CEILING_M)
            put.gate(path, along[0] + 2.2, (-WALL_M, WALL_M), up, m.CONCRETE)

    def roof(self, along: tuple[float, float], half_m: float) -> None:
        """Lay earth and grass over a bay of an underpass."""
        self.put.floor(self.path, along, (-half_m, half_m), ROOF_M, m.GRASS, 0.3)

    def lamps(self, lighting: Lighting) -> None:
        """Hang the lamps of both tubes of an underpass."""
        places = np.arange(lighting.entrance_m + 4.0, lighting.exit_m - 3.0, lighting.lamp_step_m)
        for s_m in places.tolist():
            radiance_cd_m2 = lighting.share(s_m) * lighting.lamp_cd_m2
            for across in _LAMP_ROWS_M:
                for side in (-1.0, 1.0):
                    self._lamp(s_m, side * across, radiance_cd_m2)

    def _lamp(self, s_m: float, across: float, radiance_cd_m2: float) -> None:
        """Hang one lamp in a housing whose sides keep its light out of drivers' eyes."""
        put, path = self.put, self.path
        along, wide = (s_m, s_m + 1.3), (across - 0.25, across + 0.25)
        rim, shine = (CEILING_M - 0.5, CEILING_M), CEILING_M - 0.06
        put.floor(path, along, wide, shine, m.LAMP, underside=True, emitted_cd_m2=radiance_cd_m2)
        for end, towards in ((along[0], -1.0), (along[1], 1.0)):
            put.gate(path, end, wide, rim, m.DARK, towards=towards)
        for edge in wide:
            corners = [
                path.at(s, edge, h) for h in rim for s in (along if h == rim[0] else along[::-1])
            ]
            put.quad(corners, math.copysign(1.0, edge - across) * path.right(s_m), m.DARK)

    def portal(self, s_m: float, towards: float, wing_m: float) -> None:
        """Close the earth at an end of an underpass by a wall with a name over the opening."""
        put, path = self.put, self.path
        for side in (-1.0, 1.0):
            across = (side * WALL_M, side * (WALL_M + wing_m))
            put.gate(path, s_m, across, (0.0, ROOF_M), m.BRICK, 0.8, towards=towards)
        over = (CEILING_M, ROOF_M)
        put.gate(path, s_m, (-WALL_M, WALL_M), over, m.CONCRETE, 1.5, towards=towards)
        name, at = self.sign(), s_m + 0.03 * towards
        put.gate(path, at, (-2.2, 2.2), (5.8, 7.0), name, 2.0, towards=towards, solid=False)

    def inner_signs(self, from_m: float, to_m: float) -> None:
        """Hang signs and cabinets on the walls of an underpass."""
        rng = self.rng
        for s_m in np.arange(from_m, to_m, 4.0):
            side = float(rng.choice([-1.0, 1.0]))
            low, wide = rng.uniform(0.8, 2.2), rng.uniform(0.6, 1.6)
            plate = self.sign(self.colour())
            start = float(s_m + rng.uniform(0.0, 1.5))
            along, at = (start, start + wide), side * (WALL_M - 0.03)
            self.put.wall(self.path, along, at, (low, low + 1.2), plate, 2.0, solid=False)

    def houses(self, along: tuple[float, float], side: float) -> None:
        """Build a row of houses on one side (-1 or 1) with gaps between them."""
        rng, (s_m, end) = self.rng, along
        while s_m < end:
            length, near = rng.uniform(8.0, 17.0), ROAD_HALF_M + 3.2 + rng.uniform(0.0, 4.0)
            if s_m + length < end:
                self._house((s_m, s_m + length), side * near)
            s_m += length + rng.uniform(0.5, 8.0)

    def _house(self, along: tuple[float, float], near_m: float) -> None:
        far = near_m + math.copysign(12.0, near_m)
        across, up = (min(near_m, far), max(near_m, far)), (0.1, self.rng.uniform(6.0, 18.0))
        self.put.box(self.path, along, across, up, self.facade(), 1.2, top=m.DARK)

    def roadside(self, along: tuple[float, float], side: float) -> None:
        """Plant trees, poles with signs, and parked cars along one side (-1 or 1)."""
        rng, (s_m, end) = self.rng, along
        while s_m < end:
            kind = rng.random()
            if kind < 0.4:
                self.tree(s_m, side * (ROAD_HALF_M + rng.uniform(1.2, 2.6)))
            elif kind < 0.7:
                self.pole(s_m, side * (ROAD_HALF_M + rng.uniform(0.8, 2.2)))
            else:
                self.car(s_m, side * (ROAD_HALF_M + 1.2))
            s_m += rng.uniform(4.5, 11.0)

    def facade(self) -> Material:
        """Return a wall with windows."""
        tile = (self.rng.uniform(6.0, 10.0), self.rng.uniform(6.0, 9.0))
        colour = self.colour()
        return Material(f"facade{self.rng.integers(4)}", tile, colour, 0.08)

    def sign(self, colour: Colour = (1.0, 1.0, 1.0)) -> Material:
        """Return a plate with writing."""
        return Material(f"sign{self.rng.integers(6)}", None, colour)

    def colour(self) -> Colour:
        """Return a light, slightly coloured tint."""
        red, green, blue = (float(v) for v in self.rng.uniform(0.85, 1.12, 3))
        return (red, green, blue)

    def tree(self, s_m: float, across: float) -> None:
        """Plant a tree."""
        put, path, rng = self.put, self.path, self.rng
        radius, base = rng.uniform(1.2, 2.2), rng.uniform(2.2, 3.2)
        for layer in range(3):
            left = across - radius + rng.uniform(-0.4, 0.4)
            at, wide = s_m + 0.5 * layer, (left, left + 2 * radius)
            up = (base + 0.2 * layer, base + 0.2 * layer + 2 * radius)
            put.gate(path, at, wide, up, m.FOLIAGE, cutout="leaves", solid=False)
        trunk = (across - 0.13, across + 0.13)
        put.box(path, (s_m, s_m + 0.26), trunk, (0.0, base + 1.0), m.DARK, 2.0)

    def pole(self, s_m: float, across: float) -> None:
        """Put up a pole with a sign."""
        put, path = self.put, self.path
        put.box(path, (s_m, s_m + 0.12), (across - 0.06, across + 0.06), (0.0, 6.0), m.METAL)
        plate, low = self.sign(self.colour()), self.rng.uniform(2.0, 3.0)
        wide, up = (across - 0.5, across + 0.5), (low, low + 1.0)
        put.gate(path, s_m - 0.04, wide, up, plate, 2.0, solid=False)

    def car(self, s_m: float, across: float) -> None:
        """Leave a car beside or on the road."""
        self._vehicle((s_m, s_m + 4.2), (across - 0.9, across + 0.9), (0.02, 1.5))

    def van(self, s_m: float, across: float) -> None:
        """Leave a delivery van beside or on the road."""
        self._vehicle((s_m, s_m + 5.0), (across - 0.95, across + 0.95), (0.02, 2.4))

    def _vehicle(
        self, along: tuple[float, float], across: tuple[float, float], up: tuple[float, float]
    ) -> None:
        name, colour = f"car{self.rng.integers(3)}", self.colour()
        sides, ends = Material(name, None, colour), Material(f"{name}-end", None, colour)
        self.put.box(self.path, along, across, up, sides, 2.0, top=m.METAL, ends=ends)

    def bollard(self, s_m: float, across: float) -> None:
        """Put a block of light concrete, and a plastered wall further off."""
        put, path, rng = self.put, self.path, self.rng
        half, high = rng.uniform(0.2, 0.9), rng.uniform(0.5, 1.1)
        span = (across - half, across + half)
        put.box(path, (s_m, s_m + 0.6), span, (0.0, high), m.LIGHT_CONCRETE, 2.0)
        side, near = math.copysign(1.0, across), abs(across) + rng.uniform(6.0, 16.0)
        inner, outer = sorted((side * near, side * (near + rng.uniform(3.0, 7.0))))
        up = (0.0, rng.uniform(2.4, 4.0))
        put.box(path, (s_m, s_m + 4.0), (inner, outer), up, m.PLASTER)
