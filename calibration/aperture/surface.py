"""What one picture of a blank, bright surface says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.types import Frame

_SATURATED_DN = 254
_BLOCKS = 4


@dataclass(frozen=True, slots=True)
class Look:
    """One picture of the surface.

    `saturated` is a share of the pixels, 0..1. `uneven` is the largest difference between a block
    of 4 x 4 and the one opposite the centre, over the mean: light from one side shows, the
    falloff of a lens to its corners, which is the same all around, does not.
    """

    mean_dn: float
    saturated: float
    uneven: float


def look(frame: Frame) -> Look:
    """Return what a picture says, uint8 mosaic, all pixels alike."""
    image = frame.image
    high, wide = (side // (2 * _BLOCKS) * 2 for side in image.shape)
    parts = image[: high * _BLOCKS, : wide * _BLOCKS].reshape(_BLOCKS, high, _BLOCKS, wide)
    blocks = parts.mean((1, 3), dtype=np.float64)
    mean = float(image.mean(dtype=np.float64))
    uneven = float(np.abs(blocks - blocks[::-1, ::-1]).max()) / max(mean, 1.0)
    return Look(mean, float((image >= _SATURATED_DN).mean()), uneven)


def histogram(frame: Frame) -> NDArray[np.float64]:
    """Return the share of pixels at each of the 256 grey values."""
    counts = np.bincount(frame.image.ravel(), minlength=256)
    return np.asarray(counts / frame.image.size, np.float64)
