"""Thumbnails: exact means of whole mosaic groups at every size, and what is saturated."""

from __future__ import annotations

import numpy as np
import pytest

from rig.core.types import PixelFormat
from rig.vision.thumbnail import thumbnail


@pytest.mark.parametrize(("height_px", "width_px"), [(96, 128), (480, 640), (1536, 2048)])
def test_a_cell_is_the_mean_of_its_block(height_px: int, width_px: int) -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (height_px, width_px), dtype=np.uint8)
    blocks = image.reshape(48, height_px // 48, 64, width_px // 64)
    small = thumbnail(image, "bayer_rggb8")
    assert np.abs(small[0] - blocks.mean((1, 3))).max() <= 0.5
    assert np.abs(small[1] - 255 * (blocks >= 250).mean((1, 3))).max() <= 0.5


def test_cells_of_an_odd_size_take_whole_groups_of_a_mosaic() -> None:
    image = np.full((240, 324), 100, np.uint8)
    image[0::2, 0::2], image[1::2, 1::2] = 200, 20
    small = thumbnail(image, "bayer_rggb8")
    assert np.unique(small[0]).tolist() == [105]
    assert not small[1].any()


@pytest.mark.parametrize(
    ("shape", "pixel_format"),
    [((94, 128), "bayer_rggb8"), ((96, 129), "bayer_rggb8"), ((47, 64), "mono8")],
)
def test_a_picture_without_enough_whole_groups_is_refused(
    shape: tuple[int, int], pixel_format: PixelFormat
) -> None:
    with pytest.raises(ValueError, match="64 x 48 cells"):
        thumbnail(np.zeros(shape, np.uint8), pixel_format)
