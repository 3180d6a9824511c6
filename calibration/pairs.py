"""Pairs of grey pictures to calibrate from: out of a recording, or out of a folder."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from rig.calibration.board import Grey
from rig.core.errors import CalibrationError
from rig.core.types import Frame, Pair
from rig.record.reader import Recording
from rig.vision.bayer import to_grey

_PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"}
_NAMES = (("primary", "secondary"), ("left", "right"), ("cam0", "cam1"))


@dataclass(frozen=True, slots=True, eq=False)
class GreyPair:
    """Two grey pictures of one instant, each uint8 H x W."""

    trigger: int
    greys: Pair[Grey]
    offset_ns: int | None


def of_recording(recording: Recording) -> Iterator[GreyPair]:
    """Yield the complete pairs of a recording."""
    for record in recording.records():
        primary, secondary = record.shot
        if record.complete and isinstance(primary, Frame) and isinstance(secondary, Frame):
            greys = Pair(*(to_grey(f.image, f.pixel_format) for f in (primary, secondary)))
            yield GreyPair(record.trigger, greys, record.offset_ns)


def of_folder(folder: Path) -> Iterator[GreyPair]:
    """Yield the pairs of a folder: left01.jpg with right01.jpg, or primary/x.png with secondary/x.

    Raises CalibrationError when there are no pairs, a picture cannot be read, or sizes differ.
    """
    for number, (first, second) in enumerate(_matches(folder)):
        greys = Pair(_read(first), _read(second))
        if greys.primary.shape != greys.secondary.shape:
            raise CalibrationError(
                f"{second}: is {_size(greys.secondary)}, its partner {first.name} "
                f"{_size(greys.primary)}; both cameras must give pictures of one size"
            )
        yield GreyPair(number, greys, None)


def count_in_folder(folder: Path) -> int:
    """Return how many pairs a folder has; raises CalibrationError when there are none."""
    return len(_matches(folder))


def _matches(folder: Path) -> list[tuple[Path, Path]]:
    for first, second in _NAMES:
        a, b = (_by_rest(folder, name) for name in (first, second))
        pairs = [(a[rest], b[rest]) for rest in sorted(a.keys() & b.keys())]
        numbered = [pair for pair in pairs if any(map(str.isdecimal, pair[0].stem))]
        if pairs:
            return numbered or pairs
    raise CalibrationError(
        f"{folder}: has no pairs of pictures; name them left01.png and right01.png, or put them "
        "under the same names into folders primary and secondary"
    )


def _by_rest(folder: Path, name: str) -> dict[str, Path]:
    """Return the pictures of one camera by what is left of their name without the camera's."""
    inside = folder / name
    files = inside.iterdir() if inside.is_dir() else folder.iterdir()
    pictures = [file for file in files if file.suffix.lower() in _PICTURES]
    if inside.is_dir():
        return {file.name: file for file in pictures}
    return {f.name.removeprefix(name): f for f in pictures if f.name.startswith(name)}


def _read(path: Path) -> Grey:
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise CalibrationError(f"{path}: cannot be read as a picture; remove or replace it")
    return np.asarray(picture, np.uint8)


def _size(grey: Grey) -> str:
    return f"{grey.shape[1]}x{grey.shape[0]}"
