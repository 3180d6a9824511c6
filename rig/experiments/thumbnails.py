"""A recording on one page: pairs from its beginning to its end."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.core.errors import RigError
from rig.core.types import SIDES, Frame, Lost
from rig.record.frames import Frames
from rig.vision.bayer import to_bgr

COLUMNS = 8
WIDTH_PX = 240
_GREY_DN = 60


def write_sheet(recording: Path, out: Path) -> list[int]:
    """Write a picture with up to 8 columns of pairs, the primary above, evenly over the run.

    A lost frame is grey. Returns the triggers shown; raises RigError when `out` exists, cannot be
    written or there is nothing to show.
    """
    if out.exists():
        raise RigError(f"{out} exists, nothing is overwritten: name a new file")
    with Frames(recording) as frames:
        if len(frames) == 0:
            raise RigError(f"{frames.recording.path} holds no trigger to show")
        count = min(COLUMNS, len(frames))
        shown = [round(place) for place in np.linspace(0, len(frames) - 1, count)]
        lens = frames.recording.header.intrinsics.primary
        height_px = max(1, round(WIDTH_PX * lens.height_px / lens.width_px))
        rows = [
            np.hstack([_small(frames.frame(t, side), height_px) for t in shown]) for side in SIDES
        ]
    if not cv2.imwrite(str(out), np.vstack(rows)):
        raise RigError(f"{out} cannot be written; name a .png file in a folder that exists")
    return shown


def _small(shot: Frame | Lost, height_px: int) -> NDArray[np.uint8]:
    if isinstance(shot, Lost):
        return np.full((height_px, WIDTH_PX, 3), _GREY_DN, np.uint8)
    picture = to_bgr(shot.image, shot.pixel_format)
    size = (WIDTH_PX, height_px)
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
