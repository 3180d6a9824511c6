"""The front ends that judge, by name, and how their options are written."""

from __future__ import annotations

import difflib
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import UsageError
from rig.core.types import Intrinsics
from rig.evaluation.inliers import FrontEnd, InlierCounter
from rig.evaluation.odometry import OdometryCounter
from rig.vision.orb import OrbFrontEnd
from rig.vision.viso2.front_end import MatchedPoints, Viso2FrontEnd
from rig.vision.viso2.motion import Mount

SIMULATED_HEIGHT_M = 1.4
"""How high the simulated car carries its cameras; only the length of the way depends on it."""


Grey = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Comparison:
    """What a front end makes of two pictures, and what the second one cost.

    `counts` maps matches, inliers and, for viso2, bucketed and bucketed_inliers to numbers.
    `failure` says why they tell no motion, "" when they do, None when nobody looked. `ms` is the
    time that each next picture of a drive costs: its features, the matching and the inliers.
    """

    counts: Mapping[str, int]
    failure: str | None
    ms: float


class PictureCounter(Protocol):
    """Follows one camera, picture by picture."""

    def count(self, trigger: int, grey: NDArray[np.uint8]) -> float:
        """Return the inliers between the picture of `trigger - 1` and this one, NaN for none."""
        ...


class Recipe(Protocol):
    """A front end with its options, not yet tied to a camera."""

    def front_end(self, intrinsics: Intrinsics | None) -> FrontEnd:
        """Return the front end for a camera; None when nothing is known of its lens."""
        ...

    def counter(self, intrinsics: Intrinsics | None) -> PictureCounter:
        """Return what follows one such camera."""
        ...

    def compare(self, a: Grey, b: Grey, intrinsics: Intrinsics | None) -> Comparison:
        """Return the numbers of one pair; intrinsics are of both pictures."""
        ...


@dataclass(frozen=True, slots=True)
class OrbRecipe:
    """ORB; `essential` fits an essential matrix, which needs the camera's intrinsics."""

    plain: OrbFrontEnd
    essential: bool = False

    def front_end(self, intrinsics: Intrinsics | None) -> OrbFrontEnd:
        """Return the front end; raises UsageError when the lens is needed and not known."""
        if not self.essential:
            return self.plain
        if intrinsics is None:
            raise UsageError(
                "orb:geometry=essential needs the lens: judge a recording, or give --fx (--cx --cy)"
            )
        return replace(self.plain, intrinsics=intrinsics)

    def counter(self, intrinsics: Intrinsics | None) -> InlierCounter:
        """Return what counts the inliers of one camera."""
        return InlierCounter(self.front_end(intrinsics))

    def compare(self, a: Grey, b: Grey, intrinsics: Intrinsics | None) -> Comparison:
        """Return the matches and the inliers among them."""
        front_end = self.front_end(intrinsics)
        before = front_end.features(a)
        start_s = time.perf_counter()
        matches = front_end.match(before, front_end.features(b))
        ms = 1e3 * (time.perf_counter() - start_s)
        return Comparison({"matches": len(matches), "inliers": matches.inliers}, None, ms)


@dataclass(frozen=True, slots=True)
class Viso2Recipe:
    """viso2-style; `mount` says how the camera sits over the road."""

    plain: Viso2FrontEnd
    mount: Mount

    def front_end(self, intrinsics: Intrinsics | None) -> Viso2FrontEnd:
        """Return the front end; matching needs no lens."""
        return self.plain

    def counter(self, intrinsics: Intrinsics | None) -> PictureCounter:
        """Return what counts inliers and, where the lens is known, tells the motion."""
        if intrinsics is None:
            return InlierCounter(self.plain)
        return OdometryCounter(self.plain, intrinsics, self.mount)

    def compare(self, a: Grey, b: Grey, intrinsics: Intrinsics | None) -> Comparison:
        """Return the matches and inliers of all, and of those that bucketing leaves."""
        front_end = self.plain
        before = front_end.features(a)
        start_s = time.perf_counter()
        matches = front_end.match(before, front_end.features(b))
        few = front_end.bucket(MatchedPoints(matches.points_a_px, matches.points_b_px))
        kept = front_end.judged(few).inliers
        ms = 1e3 * (time.perf_counter() - start_s)
        failure = None
        if intrinsics is not None:
            failure = front_end.motion(few, intrinsics, self.mount).failure
        counts = {"matches": len(matches), "inliers": matches.inliers}
        few_counts = {"bucketed": len(few), "bucketed_inliers": kept}
        return Comparison(counts | few_counts, failure, ms)


def viso2_recipe(half_resolution: bool) -> Viso2Recipe:
    """Return the published viso2-style recipe at either resolution."""
    return Viso2Recipe(Viso2FrontEnd(half_resolution), Mount(height_m=SIMULATED_HEIGHT_M))


FrontEnds = Mapping[str, Recipe]

FRONT_ENDS: FrontEnds = {
    "orb": OrbRecipe(OrbFrontEnd()),
    "viso2": viso2_recipe(half_resolution=True),
}
"""Every front end as published, under its name in summary.json: they judge where nobody says else.

Both, so that a race, its report and a later evaluation say the same of the same recording.
"""


def parse_front_ends(text: str, defaults: FrontEnds = FRONT_ENDS) -> FrontEnds:
    """Return the front ends that `orb:size=full,features=5000,viso2:half=no` names.

    Raises UsageError for a name, an option or a value that there is not, and for a name twice.
    """
    chosen: dict[str, Recipe] = {}
    options: dict[str, dict[str, str]] = {}
    current = ""
    for word in (part.strip() for part in text.split(",")):
        name, colon, rest = word.partition(":")
        if not colon and "=" in word:
            rest = word
        else:
            current = _known(name, defaults, "front end")
            if current in options:
                raise UsageError(f"front end {current} is named twice in {text!r}")
            options[current] = {}
        if rest:
            if not current:
                raise UsageError(f"{word!r} in {text!r} belongs to no front end: write orb:{word}")
            key, equals, value = rest.partition("=")
            if not equals:
                raise UsageError(f"{rest!r} of {current}: write option=value")
            options[current][key] = value
    for name, given in options.items():
        chosen[name] = _with(name, defaults[name], given)
    return chosen


def _with(name: str, recipe: Recipe, given: Mapping[str, str]) -> Recipe:
    known = _OPTIONS[name]
    for key, value in given.items():
        setter = known[_known(key, known, f"option of {name}")]
        try:
            recipe = setter(recipe, value)
        except ValueError as error:
            raise UsageError(f"{name}:{key}={value}: {error}") from None
    return recipe


def _known(name: str, choices: Mapping[str, Any], what: str) -> str:
    if name in choices:
        return name
    near = difflib.get_close_matches(name, choices, 1)
    hint = f", did you mean {near[0]}?" if near else f"; there are: {', '.join(choices)}"
    raise UsageError(f"unknown {what} {name!r}{hint}")


def _orb(field: str, read: Callable[[str], Any]) -> Callable[[Any, str], OrbRecipe]:
    return lambda recipe, value: replace(
        recipe, plain=replace(recipe.plain, **{field: read(value)})
    )


def _size(value: str) -> tuple[int, int] | None:
    if value == "full":
        return None
    width, times, height = value.partition("x")
    if not (times and width.isdigit() and height.isdigit()) or min(int(width), int(height)) < 32:
        raise ValueError("write WIDTHxHEIGHT, at least 32x32, or full")
    return int(width), int(height)


def _whole(value: str) -> int:
    if not value.isdigit() or not 1 <= int(value) <= 100_000:
        raise ValueError("write a whole number from 1 to 100000")
    return int(value)


def _positive(value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not (math.isfinite(number) and number > 0):
        raise ValueError("write a number above 0")
    return number


def _degrees(value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not -90 < number < 90:
        raise ValueError("write degrees between -90 and 90")
    return math.radians(number)


def _one_of(*words: str) -> Callable[[str], str]:
    def read(value: str) -> str:
        if value not in words:
            raise ValueError(f"write {' or '.join(words)}")
        return value

    return read


def _yes(value: str) -> bool:
    return _one_of("yes", "no")(value) == "yes"


_OPTIONS: Mapping[str, Mapping[str, Callable[[Any, str], Recipe]]] = {
    "orb": {
        "size": _orb("size_px", _size),
        "features": _orb("features_max", _whole),
        "threshold_px": _orb("ransac_px", _positive),
        "estimator": _orb("estimator", _one_of("ransac", "magsac")),
        "geometry": lambda recipe, value: replace(
            recipe, essential=_one_of("fundamental", "essential")(value) == "essential"
        ),
    },
    "viso2": {
        "half": lambda recipe, value: replace(
            recipe, plain=replace(recipe.plain, half_resolution=_yes(value))
        ),
        "height_m": lambda recipe, value: replace(
            recipe, mount=replace(recipe.mount, height_m=_positive(value))
        ),
        "pitch_deg": lambda recipe, value: replace(
            recipe, mount=replace(recipe.mount, pitch_rad=_degrees(value))
        ),
    },
}
