"""The worlds that can be opened by name."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

from rig.core.errors import UsageError
from rig.core.types import Intrinsics
from rig.drivers.scenes import chessboard, door, doorway, indoor, wall
from rig.drivers.scenes.optics import Optics, through_optics, wide_lens
from rig.drivers.scenes.road import road
from rig.drivers.scenes.route import route
from rig.drivers.scenes.scene import Scene
from rig.drivers.scenes.tunnel import tunnel
from rig.drivers.scenes.world import Plan, RenderedScene, bake_world, lens_for

SPLITS = ("train", "test")


class Builder(Protocol):
    """Plans one world of a family."""

    def __call__(self, seed: int, split: str, speed_mps: float) -> Plan:
        """Return the plan of the world `seed` of a split, driven through at a speed."""
        ...


class RoomBuilder(Protocol):
    """Plans one world of a family of buildings."""

    def __call__(self, seed: int, split: str, speed_mps: float, options: Mapping[str, str]) -> Plan:
        """Return the plan of the world `seed` of a split; raises UsageError for an option."""
        ...


class Studio(Protocol):
    """Opens a world that is looked at, not driven through."""

    def __call__(self, seed: int, lens: Intrinsics, options: Mapping[str, str]) -> Scene:
        """Return the scene; raises UsageError for an option that cannot be meant."""
        ...


WORLDS: Mapping[str, Builder] = {"tunnel": tunnel, "route": route, "road": road}
ROOMS: Mapping[str, RoomBuilder] = {
    "door": door.door,
    "doorway": doorway.doorway,
    "indoor": indoor.indoor,
}
STUDIOS: Mapping[str, Studio] = {
    "wall": wall.open_wall,
    "chessboard": chessboard.open_chessboard,
}
NAMES = (*WORLDS, *ROOMS, *STUDIOS)

WORLD_OPTIONS: Mapping[str, tuple[str, ...]] = {
    "door": door.OPTIONS,
    "doorway": doorway.OPTIONS,
    "indoor": indoor.OPTIONS,
    "wall": wall.OPTIONS,
    "chessboard": chessboard.OPTIONS,
}
"""The options that only one world has."""

SPEEDS_MPS: Mapping[str, float] = {
    "door": door.SPEED_MPS,
    "doorway": doorway.SPEED_MPS,
    "indoor": indoor.SPEED_MPS,
}
"""How fast the drive through a world is where an address does not say, if not as a car."""


def open_world(
    name: str,
    *,
    seed: int,
    split: str,
    width_px: int,
    height_px: int,
    speed_mps: float,
    optics: Optics | None = None,
    **options: str,
) -> Scene:
    """Return the scene of a world family, its light baked or taken from the cache.

    `seed` >= 0 picks the world within its `split` (train or test); the splits share no world.
    `optics` is what stands before the sensor besides an ideal lens.
    Raises UsageError for an unknown world, split or option, or a number out of range.
    """
    if name not in NAMES:
        near = difflib.get_close_matches(name, NAMES, 1)
        hint = f"did you mean {near[0]}?" if near else f"known worlds: {', '.join(NAMES)}"
        raise UsageError(f"no world is called {name!r}; {hint}")
    if split not in SPLITS:
        raise UsageError(f"world {name}: split must be train or test, got {split!r}")
    for option in options:
        if option not in WORLD_OPTIONS.get(name, ()):
            raise UsageError(f"world {name} has no option {option!r}; remove it")
    if seed < 0:
        raise UsageError(f"world {name}: seed must be 0 or more, got {seed}")
    if not speed_mps > 0:
        raise UsageError(f"world {name}: speed_mps must be above 0, got {speed_mps}")
    if min(width_px, height_px) < 16:
        raise UsageError(f"world {name}: size must be at least 16x16, got {width_px}x{height_px}")
    lens = lens_for(width_px, height_px)
    if optics is None:
        return _open(name, seed, split, speed_mps, lens, options)
    lens = replace(lens, distortion=optics.distortion)
    scene = _open(name, seed, split, speed_mps, wide_lens(lens), options)
    return through_optics(scene, lens, optics, seed)


def _open(
    name: str, seed: int, split: str, speed_mps: float, lens: Intrinsics, options: Mapping[str, str]
) -> Scene:
    if name in STUDIOS:
        return STUDIOS[name](seed, lens, options)
    if name in ROOMS:
        plan = ROOMS[name](seed, split, speed_mps, options)
    else:
        plan = WORLDS[name](seed, split, speed_mps)
    return RenderedScene(bake_world(plan), lens)
