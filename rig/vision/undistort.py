"""Takes the lens distortion out of pictures, as a calibration describes it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics


class Undistorter:
    """Maps grey pictures of one size to what a pinhole camera with the same matrix sees.

    `distortion` is OpenCV's k1 k2 p1 p2 k3 (Brown 1966). Bilinear; what lies outside the picture
    is black.
    """

    def __init__(self, lens: Intrinsics, distortion: tuple[float, ...]) -> None:
        self.lens = lens
        matrix = np.array([[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1.0]])
        size = (lens.width_px, lens.height_px)
        self._map, self._fractions = cv2.initUndistortRectifyMap(
            matrix, np.array(distortion), np.eye(3), matrix, size, cv2.CV_16SC2
        )

    def apply(self, grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the undistorted H x W picture; raises ValueError for another size."""
        expected = (self.lens.height_px, self.lens.width_px)
        if grey.shape != expected:
            raise ValueError(f"the lens is calibrated for {expected}, the picture is {grey.shape}")
        return np.asarray(
            cv2.remap(grey, self._map, self._fractions, cv2.INTER_LINEAR), dtype=np.uint8
        )


def scaled(lens: Intrinsics, width_px: int, height_px: int) -> Intrinsics:
    """Return the intrinsics for the same view in another number of pixels."""
    share = width_px / lens.width_px
    return Intrinsics(
        width_px,
        height_px,
        lens.fx_px * share,
        lens.fy_px * share,
        (lens.cx_px + 0.5) * share - 0.5,
        (lens.cy_px + 0.5) * share - 0.5,
    )
