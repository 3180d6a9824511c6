"""What the browser gets: the newest pictures as small JPEGs and the newest state as JSON."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from rig.core.types import SIDES, Frame, Pair
from rig.vision.bayer import to_bgr

WIDEST_PX = 480
_JPEG_QUALITY = 75


@dataclass(slots=True, eq=False)
class Page:
    """The newest state, numbered; whoever waits for a newer one is woken up.

    `banner` stands before the title of every state.
    """

    banner: str = ""
    _state: bytes = b'{"n": 0}'
    _pictures: dict[str, bytes] = field(default_factory=dict)
    _number: int = 0
    _changed: threading.Condition = field(default_factory=threading.Condition)

    def show(self, state: dict[str, Any], frames: Pair[Frame | None]) -> None:
        """Become the next number, with `state` and the pictures of those frames that came."""
        pictures: dict[str, bytes] = {
            side: encode(frame)
            for side, frame in zip(SIDES, frames, strict=True)
            if frame is not None
        }
        banner = {"banner": self.banner} if self.banner else {}
        with self._changed:
            self._number += 1
            self._state = json.dumps({**state, **banner, "n": self._number}).encode()
            self._pictures |= pictures
            self._changed.notify_all()

    def state_after(self, number: int, timeout_s: float) -> bytes:
        """Return the state once it is newer than `number`, or as it is when the time is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._number > number, timeout_s)
            return self._state

    def picture(self, side: str) -> bytes | None:
        """Return the newest JPEG of one camera; None before the first."""
        with self._changed:
            return self._pictures.get(side)


def encode(frame: Frame) -> bytes:
    """Return a frame as JPEG, at most 480 px wide.

    The mosaic is thinned by whole Bayer cells before anything else, so that a full-size picture
    costs no more than a small one.
    """
    step = max(1, frame.image.shape[1] // (2 * WIDEST_PX))
    cells = frame.image[: frame.image.shape[0] // 2 * 2, : frame.image.shape[1] // 2 * 2]
    height, width = cells.shape
    grouped = cells.reshape(height // 2, 2, width // 2, 2)[::step, :, ::step]
    small = np.ascontiguousarray(grouped).reshape(grouped.shape[0] * 2, grouped.shape[2] * 2)
    colour = to_bgr(small, frame.pixel_format)
    if colour.shape[1] > WIDEST_PX:
        size = (WIDEST_PX, round(WIDEST_PX * colour.shape[0] / colour.shape[1]))
        colour = np.asarray(cv2.resize(colour, size, interpolation=cv2.INTER_AREA), np.uint8)
    done, coded = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return coded.tobytes() if done else b""
