"""Where a metric looks: at every pixel of a picture, or at little tiles spread over it.

A controller cannot afford every pixel of a full picture. Shrinking it would average away the noise
and sharpen the gradients that the metrics measure. So it looks at 8 x 8 tiles, evenly spread, of
which the middle 4 x 4 pixels are judged with their true neighbours; every place of the colour
mosaic is seen alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.core.types import PixelFormat
from rig.vision.bayer import to_bgr, to_grey

TILE_PX, EDGE_PX = 8, 2
"""An edge is the neighbours of what is judged, and those from which a demosaic makes them."""

TILES_ACROSS = 86
SMALL_PX = 120
"""Below this width or height a picture is looked at as a whole."""


class Places(NamedTuple):
    """Rows and columns of a picture, strictly inside it; what counts is where they cross."""

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A part of a picture: `mosaic` as it came, H x W, and the `places` that may be judged."""

    mosaic: NDArray[np.uint8]
    pixel_format: PixelFormat
    places: Places

    def grey(self) -> NDArray[np.uint8]:
        """Return the sample in grey, H x W."""
        return to_grey(self.mosaic, self.pixel_format)

    def colour(self) -> NDArray[np.uint8]:
        """Return the sample in colour, H x W x 3, or H x W where the camera sees no colours."""
        if self.pixel_format == "mono8":
            return self.mosaic
        return to_bgr(self.mosaic, self.pixel_format)

    def judged(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the pixels of `picture` at the places, one beside the other."""
        return picture[np.ix_(*self.places)]


def sample(
    image: NDArray[np.uint8], pixel_format: PixelFormat, tiles_across: int = TILES_ACROSS
) -> Sample:
    """Return evenly spread tiles of a picture, about `tiles_across` in a row.

    A picture less than 120 pixels wide or high is returned as a whole.
    """
    height, width = image.shape
    if min(height, width) < SMALL_PX:
        return Sample(image, pixel_format, inner(image))
    period = max(2 * round(width / tiles_across / 2), TILE_PX)
    down, across = height // period, width // period
    tiles = image[: down * period, : across * period].reshape(down, period, across, period)
    middle = (period - TILE_PX) // 2 & ~1
    part = slice(middle, middle + TILE_PX)
    mosaic = tiles[:, part, :, part].reshape(down * TILE_PX, across * TILE_PX)
    return Sample(
        np.ascontiguousarray(mosaic), pixel_format, Places(_centres(down), _centres(across))
    )


def inner(picture: NDArray[np.uint8]) -> Places:
    """Return every place of a picture but its border."""
    height, width = picture.shape[:2]
    return Places(np.arange(1, height - 1), np.arange(1, width - 1))


def bordered(picture: NDArray[np.uint8], border: int) -> tuple[NDArray[np.uint8], Places]:
    """Return a picture with one more pixel around it, by OpenCV's `border`, and all its places."""
    wider = cv2.copyMakeBorder(picture, 1, 1, 1, 1, border, value=0)
    larger = np.asarray(wider, np.uint8)
    return larger, inner(larger)


def _centres(tiles: int) -> NDArray[np.int64]:
    judged = np.arange(EDGE_PX, TILE_PX - EDGE_PX)
    return np.add.outer(np.arange(tiles) * TILE_PX, judged).ravel()
