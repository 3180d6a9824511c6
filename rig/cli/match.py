"""`rig match A B`: what the front ends make of any two pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from cyclopts import Parameter
from numpy.typing import NDArray

from rig.cli.exits import OK
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.errors import RigError, UsageError
from rig.core.types import Intrinsics
from rig.evaluation.front_ends import (
    FRONT_ENDS,
    FrontEnds,
    OrbRecipe,
    Recipe,
    parse_front_ends,
    viso2_recipe,
)
from rig.vision.orb import OrbFrontEnd

SMALLEST_PX = 32

Grey = NDArray[np.uint8]


def match(
    a: Path,
    b: Path,
    /,
    *,
    front_end: str = "orb,viso2",
    half: Annotated[bool, Parameter(negative="")] = False,
    fx: float | None = None,
    fy: float | None = None,
    cx: float | None = None,
    cy: float | None = None,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Match two pictures by the front ends that judge drives, and count matches and inliers.

    Parameters
    ----------
    a:
        The first picture, in any format that OpenCV reads; colour becomes grey.
    b:
        The second picture.
    front_end:
        Front ends with their options, as in `rig evaluate`: orb, viso2, orb:size=full, ...
    half:
        Let viso2 look for features at half resolution, as drives are judged.
    fx:
        Focal length in pixels: viso2 then says whether the pictures tell a motion.
    fy:
        Vertical focal length in pixels; fx when absent.
    cx:
        Principal point in pixels; the middle of the picture when absent.
    cy:
        Principal point in pixels; the middle of the picture when absent.
    """
    front_ends = parse_front_ends(front_end, published(half, essential=fx is not None))
    pictures = read(a), read(b)
    lens = intrinsics(pictures[0], fx, fy, cx, cy)
    if pictures[0].shape != pictures[1].shape and lens is not None:
        raise RigError(f"{different_sizes(a, b, pictures)}; --fx describes one lens: leave it out")
    results = [measure(name, recipe, pictures, lens) for name, recipe in front_ends.items()]
    values = results[0] if len(results) == 1 else {told["front_end"]: told for told in results}
    terminal.result("\n".join(words(told) for told in results), values)
    return OK


def published(half: bool, essential: bool) -> FrontEnds:
    """Return the front ends of the drives, but viso2 at full resolution unless `half`.

    With `essential`, when the lens is known, ORB fits an essential matrix.
    """
    orb = OrbRecipe(OrbFrontEnd(), essential)
    return {**FRONT_ENDS, "orb": orb, "viso2": viso2_recipe(half)}


def read(path: Path) -> Grey:
    """Return a picture as grey bytes, 16 bits scaled down; raises RigError when it is none."""
    if not path.is_file():
        raise RigError(f"{path}: no such picture; give the path of an image file")
    data = np.fromfile(path, np.uint8)
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    grey = cv2.imdecode(data, flags) if data.size else None
    if grey is None:
        raise RigError(f"{path}: cannot be read as a picture; repair it or save it as PNG")
    if min(grey.shape) < SMALLEST_PX:
        height_px, width_px = grey.shape
        raise RigError(
            f"{path}: {width_px} x {height_px} px is too small to look for features in; "
            f"give at least {SMALLEST_PX} x {SMALLEST_PX}"
        )
    return np.asarray(grey, np.uint8)


def different_sizes(a: Path, b: Path, pictures: tuple[Grey, Grey]) -> str:
    """Return that two pictures differ in size, in words."""
    (height_a, width_a), (height_b, width_b) = (picture.shape for picture in pictures)
    return f"{a} has {width_a} x {height_a} px and {b} has {width_b} x {height_b}: not one size"


def intrinsics(
    picture: Grey, fx: float | None, fy: float | None, cx: float | None, cy: float | None
) -> Intrinsics | None:
    """Return the lens that the options describe; raises UsageError when they make none."""
    if fx is None:
        if any(value is not None for value in (fy, cx, cy)):
            raise UsageError("--fy, --cx and --cy say nothing without --fx: give it in pixels")
        return None
    height_px, width_px = picture.shape
    fy = fx if fy is None else fy
    for name, value in (("--fx", fx), ("--fy", fy)):
        if not (np.isfinite(value) and value > 0):
            raise UsageError(f"{name} must be above 0 px, got {value}")
    middle = (width_px - 1) / 2, (height_px - 1) / 2
    return Intrinsics(
        width_px,
        height_px,
        fx,
        fy,
        middle[0] if cx is None else cx,
        middle[1] if cy is None else cy,
    )


def measure(
    name: str, recipe: Recipe, pictures: tuple[Grey, Grey], lens: Intrinsics | None
) -> dict[str, Any]:
    """Return what one front end makes of two pictures; its time is that of a warm second go."""
    recipe.compare(*pictures, lens)
    told = recipe.compare(*pictures, lens)
    motion = {} if told.failure is None else {"motion": told.failure or "told"}
    return {"front_end": name, **told.counts, **motion, "ms": told.ms}


def words(told: dict[str, Any]) -> str:
    """Return one front end's numbers as a line for a person."""
    text = f"{told['front_end']:<6} {told['matches']:>6} matches, {told['inliers']:>6} inliers"
    if "bucketed" in told:
        text += f"; bucketed {told['bucketed']}, of them {told['bucketed_inliers']} inliers"
    if "motion" in told:
        text += f"; motion: {told['motion']}"
    return f"{text}; {told['ms']:.1f} ms"
