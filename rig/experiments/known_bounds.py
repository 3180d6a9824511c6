"""The bounds of drives that were worked out before: by the user, or in what comes with the rig."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rig.config import camera_digest
from rig.core.types import Settings
from rig.drivers.addresses import Address, parse_address
from rig.drivers.scenes.cache import cache_folder

RECIPE = "1"
"""Counts the ways in which bounds were worked out; one of another way is not used."""

SHIPPED = Path(__file__).with_name("bounds.json")
"""Bounds that come with the rig, by `tools/freeze_bounds.py`; `recipe` says how they were made."""

_OF_THE_DRIVE_ONLY = ("decision_ms", "latency_frames")


@dataclass(frozen=True, slots=True)
class Reach:
    """How far the settings may move from one frame to the next.

    At most so many steps of the grid for exposure and gain, and a change of brightness (exposure
    times gain) of at most `brightness_ev`: further moves cost more matches than they win.
    """

    exposures: int = 2
    gains: int = 1
    brightness_ev: float = 2.0


@dataclass(frozen=True, slots=True)
class Constant:
    """Settings that never change, and what they have."""

    settings: Settings
    median: float
    min: int


@dataclass(frozen=True, slots=True)
class Replayed:
    """What the two paths have in other noise, each its own figure: means over five draws.

    A controller cannot know the noise, so what it could reach lies between this and the bound:
    below the bound, and above this where another path has more that is no luck.
    """

    median: float
    min: float


@dataclass(frozen=True, slots=True)
class Bound:
    """The best median and the best minimum of inliers that any path over the grid has.

    `best_constant` has the best median of all constants (of equal ones the best minimum),
    `steadiest_constant` the best minimum (of equal ones the best median). `grid` is (number of
    exposures, number of gains), `pairs` the number of counts.
    """

    cameras: str
    grid: tuple[int, int]
    best_median: int
    best_min: int
    best_constant: Constant
    steadiest_constant: Constant
    replayed: Replayed
    reach: Reach
    pairs: int
    world_version: str


def known_bound(cameras: str, world_version: str) -> Bound | None:
    """Return the bound of a whole drive where it was worked out before, or None.

    `cameras` is the resolved address of an opened source, as recordings and summaries carry it.
    What the user worked out comes before what comes with the rig.
    """
    return _remembered(cameras, world_version) or _shipped(cameras, world_version)


@cache
def shipped_bounds() -> dict[str, Bound]:
    """Return the bounds that come with the rig by their scenes, none of another recipe."""
    shipped = json.loads(SHIPPED.read_text(encoding="utf-8"))
    bounds = map(_bound_from, shipped["bounds"]) if shipped["recipe"] == RECIPE else ()
    return {scene_of(bound.cameras): bound for bound in bounds}


def remember(bound: Bound) -> None:
    """Keep the bound of a whole drive in the user's cache."""
    path = _memory(bound.cameras, bound.world_version)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part")
    unfinished.write_text(json.dumps(asdict(bound)), encoding="utf-8")
    unfinished.replace(path)


def scene_of(cameras: str) -> str:
    """Return an address without the options that change no picture of given settings.

    A camera's file, which may change, stands in it by its digest as well.
    """
    parsed = parse_address(cameras)
    kept = {k: v for k, v in parsed.options.items() if k not in _OF_THE_DRIVE_ONLY}
    digest = camera_digest(parsed.options.get("camera", ""))
    return str(Address(parsed.scheme, parsed.name, kept)) + digest


def method() -> str:
    """Return what made the counts that are kept: another one must count again."""
    return f"{version('exposure-rig')} {RECIPE}"


def _remembered(cameras: str, world_version: str) -> Bound | None:
    try:
        values = json.loads(_memory(cameras, world_version).read_text(encoding="utf-8"))
        return _bound_from(values)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _shipped(cameras: str, world_version: str) -> Bound | None:
    try:
        bound = shipped_bounds().get(scene_of(cameras))
    except OSError:  # the camera's file is gone
        return None
    return bound if bound and bound.world_version == world_version else None


def _memory(cameras: str, world_version: str) -> Path:
    words = f"{scene_of(cameras)} {world_version} {method()}"
    return cache_folder() / "bounds" / f"{hashlib.sha256(words.encode()).hexdigest()[:24]}.json"


def _bound_from(values: dict[str, Any]) -> Bound:
    constants = {
        name: Constant(**{**values[name], "settings": Settings(**values[name]["settings"])})
        for name in ("best_constant", "steadiest_constant")
    }
    parts = {"replayed": Replayed(**values["replayed"]), "reach": Reach(**values["reach"])}
    return Bound(**{**values, **constants, **parts, "grid": tuple(values["grid"])})
