"""Pictures that no rig recorded, a video or a folder of them, judged by the same front ends."""

from __future__ import annotations

import re
from collections.abc import Generator
from contextlib import closing
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.core.errors import RecordingError
from rig.evaluation.front_ends import FRONT_ENDS, FrontEnds
from rig.evaluation.series import Column
from rig.evaluation.statistics import BLIND_BELOW, inlier_statistics

PICTURE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".tif", ".webp"})


@dataclass(frozen=True, slots=True, eq=False)
class PictureSeries:
    """Inliers of each picture with the one before it; the first has none (NaN).

    `inliers` maps a front end's name to one count a picture, `mean_grey_dn` is 0..255.
    """

    inliers: dict[str, Column]
    mean_grey_dn: Column

    def statistics(self) -> dict[str, dict[str, Any]]:
        """Return the statistics of each front end, keyed as in summary.json.

        Every count is counted: there is no controller to warm up, and no settings to tell.
        """
        return {
            name: asdict(inlier_statistics(counts[~np.isnan(counts)], BLIND_BELOW[name]))
            for name, counts in self.inliers.items()
        }


def judge_pictures(
    path: Path, *, step: int = 1, front_ends: FrontEnds = FRONT_ENDS
) -> PictureSeries:
    """Return the inliers between every `step`-th picture of a video or folder and the one before.

    Holds one picture at a time. Raises RecordingError as `grey_pictures` does, and ValueError when
    step < 1.
    """
    if step < 1:
        raise ValueError(f"step must be at least 1, got {step}")
    counters = {name: recipe.counter(None) for name, recipe in front_ends.items()}
    counts: dict[str, list[float]] = {name: [] for name in front_ends}
    greys: list[float] = []
    with closing(grey_pictures(path)) as pictures:
        for index, grey in enumerate(islice(pictures, None, None, step)):
            greys.append(float(grey.mean()))
            for name, counter in counters.items():
                counts[name].append(counter.count(index, grey))
    return PictureSeries(
        {name: np.array(column, np.float64) for name, column in counts.items()},
        np.array(greys, np.float64),
    )


def grey_pictures(path: Path) -> Generator[NDArray[np.uint8]]:
    """Yield the grey pictures, uint8 H x W, of a video or of a folder in the order of its names.

    Numbers in names count as numbers: 9.png comes before 10.png. Raises RecordingError when there
    is nothing at `path`, it holds no picture, or one cannot be read.
    """
    if path.is_dir():
        yield from _of_folder(path)
    elif path.is_file():
        yield from _of_video(path)
    else:
        raise RecordingError(f"{path}: no such video or folder; give the path of one")


def _of_folder(folder: Path) -> Generator[NDArray[np.uint8]]:
    names = [item for item in folder.iterdir() if item.suffix.lower() in PICTURE_SUFFIXES]
    if not names:
        endings = " ".join(sorted(PICTURE_SUFFIXES))
        raise RecordingError(f"{folder}: no picture in this folder; looked for {endings}")
    for name in sorted(names, key=natural_order):
        bgr = cv2.imread(str(name), cv2.IMREAD_COLOR)
        if bgr is None:
            raise RecordingError(f"{name}: cannot be read as a picture; repair or remove it")
        yield _grey(bgr)


def _of_video(file: Path) -> Generator[NDArray[np.uint8]]:
    video = cv2.VideoCapture(str(file))
    try:
        came, bgr = video.read()
        if not came:
            raise RecordingError(f"{file}: cannot be read as a video; try it in a video player")
        while came:
            yield _grey(bgr)
            came, bgr = video.read()
    finally:
        video.release()


def _grey(bgr: NDArray[Any]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), np.uint8)


def natural_order(path: Path) -> list[tuple[int, str]]:
    """Return a sort key in which runs of digits compare as numbers."""
    return [
        (int(part), "") if part.isdigit() else (-1, part)
        for part in re.split(r"(\d+)", path.name)
        if part
    ]
