"""Scores of one picture, by which exposure methods of the literature judge it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def mean_dn(image: NDArray[np.uint8]) -> float:
    """Return the mean grey of a picture or mosaic, 0..255."""
    return float(cv2.mean(image)[0])
