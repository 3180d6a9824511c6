"""The world `wall`: a blank, evenly lit surface before two cameras that stand still.

The lens of the secondary camera has an aperture ring that nobody has set yet: how far it is from
the primary's is drawn from the seed, or given as `aperture_offset_stops`. Whoever turns it feels
only the ring, never the number; the pictures have to tell.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import UsageError
from rig.core.types import Intrinsics, Side, Truth
from rig.drivers.scenes.geometry import Assembly, Material
from rig.drivers.scenes.light import Sunlight
from rig.drivers.scenes.textures import MACRO
from rig.drivers.scenes.trajectories import Drive, Path
from rig.drivers.scenes.world import Plan, RenderedScene, RenderedView, bake_world

WALL_VERSION = "wall/2"

_RADIANCE_CD_M2 = 100.0
_DISTANCE_M = 2.0
_HALF_M = 10.0
_STAND_S = 12.0

_LARGEST_OFFSET_STOPS = 1.5
_DEGREES_PER_STOP = (24.0, 36.0)
_TRAVEL_STOPS = 3.0


class ApertureRing:
    """The ring on the secondary's lens: it can be turned, and it does not say where it stands.

    It opens when turned by positive degrees, has a stop at both ends of its travel, and 24 to 36
    degrees, drawn from the seed, make one stop.
    """

    def __init__(self, seed: int, offset_stops: float | None) -> None:
        rng = np.random.default_rng([seed, 1951])
        drawn = float(rng.uniform(0.3, _LARGEST_OFFSET_STOPS) * rng.choice([-1.0, 1.0]))
        self._stops = drawn if offset_stops is None else offset_stops
        self._degrees_per_stop = float(rng.uniform(*_DEGREES_PER_STOP))

    def turn(self, degrees: float) -> None:
        """Turn the ring; it does not go past its ends."""
        wanted = self._stops + degrees / self._degrees_per_stop
        self._stops = min(max(wanted, -_TRAVEL_STOPS), _TRAVEL_STOPS)

    def transmits(self) -> float:
        """Return the light that passes, as a factor of what the primary's lens lets through."""
        return math.pow(2.0, self._stops)


@dataclass(frozen=True, slots=True, eq=False)
class StillView:
    """What a camera sees that does not move: no exposure is long enough to blur it."""

    radiance_cd_m2: NDArray[np.float32]
    depth_m: NDArray[np.float32]

    def exposed(self, exposure_us: float) -> NDArray[np.float32]:
        """Return the radiance, H x W, cd/m2."""
        return self.radiance_cd_m2


@dataclass(frozen=True, eq=False)
class WallScene:
    """A `Scene`: the wall, seen through two lenses of which one has a ring to turn."""

    rendered: RenderedScene
    ring: ApertureRing

    @property
    def world_version(self) -> str:
        """Return the version of this world."""
        return self.rendered.world_version

    @property
    def drive_s(self) -> float:
        """Return how long the cameras stand, seconds."""
        return self.rendered.drive_s

    def intrinsics(self, side: Side) -> Intrinsics:
        """Return the pinhole intrinsics of one camera."""
        return self.rendered.intrinsics(side)

    def view(self, side: Side, time_s: float) -> StillView:
        """Return what one camera sees; the same at any time until the ring is turned."""
        still: RenderedView = self.rendered.view(side, 0.0)
        passed = 1.0 if side == "primary" else self.ring.transmits()
        return StillView(still.radiance_cd_m2 * np.float32(passed), still.depth_m)

    def truth(self, time_s: float) -> Truth:
        """Return where the primary camera is and how bright its view is."""
        return self.rendered.truth(0.0)


def open_wall(seed: int, lens: Intrinsics, options: Mapping[str, str]) -> WallScene:
    """Return the wall; raises UsageError for an offset that is no number of stops."""
    word = options.get("aperture_offset_stops")
    offset_stops = None if word is None else _stops(word)
    rendered = RenderedScene(bake_world(wall()), lens)
    return WallScene(rendered, ApertureRing(seed, offset_stops))


OPTIONS = ("aperture_offset_stops",)


def _stops(word: str) -> float:
    try:
        stops = float(word)
    except ValueError:
        stops = math.nan
    if not abs(stops) <= _TRAVEL_STOPS:
        raise UsageError(
            f"sim:wall: aperture_offset_stops must be -{_TRAVEL_STOPS:g} to {_TRAVEL_STOPS:g}, "
            f"got {word!r}"
        )
    return stops


def wall() -> Plan:
    """Return the plan of a white wall of 100 cd/m2; every seed, split and speed is alike."""
    path = Path((), _DISTANCE_M)
    put = Assembly(np.random.default_rng(0))
    across = (-_HALF_M, _HALF_M)
    put.gate(path, _DISTANCE_M, across, across, Material("white", None))
    dark_sky = np.zeros((3, 4, 4), np.float32)
    light = Sunlight(np.array([0.0, 1.0, 0.0]), 0.0, _RADIANCE_CD_M2, _RADIANCE_CD_M2)
    white = np.ones((4, 4), np.float32)
    return Plan(
        key="wall",
        version=WALL_VERSION,
        quads=put.quads,
        textures=lambda: {MACRO: white, "white": white},
        sky=lambda: dark_sky,
        sun=light,
        drive=Drive(path, 0.0, 0.0, 0.0, 0.0, (), (), (), (), ()),
        drive_s=_STAND_S,
    )
