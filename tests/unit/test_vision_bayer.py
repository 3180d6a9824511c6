"""Colour pictures from the mosaic: right channels, right averages."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.core.types import PixelFormat
from rig.vision.bayer import to_bgr, to_grey, to_rgb224

RED, GREEN, BLUE = 200, 100, 20


def mosaic_of_one_colour(height_px: int = 32, width_px: int = 48) -> NDArray[np.uint8]:
    image = np.full((height_px, width_px), GREEN, np.uint8)
    image[0::2, 0::2] = RED
    image[1::2, 1::2] = BLUE
    return image


def area_average(plane: NDArray[np.float64], cells: int) -> NDArray[np.float64]:
    """Return the exact area average of a piecewise-constant plane, as two overlap matrices."""

    def overlaps(pixels: int) -> NDArray[np.float64]:
        matrix = np.zeros((cells, pixels))
        for cell in range(cells):
            low, high = cell * pixels / cells, (cell + 1) * pixels / cells
            for pixel in range(pixels):
                matrix[cell, pixel] = max(0.0, min(high, pixel + 1) - max(low, pixel))
        return matrix / matrix.sum(axis=1, keepdims=True)

    height_px, width_px = plane.shape
    return overlaps(height_px) @ plane @ overlaps(width_px).T


def test_a_red_scene_is_red_in_every_picture() -> None:
    image = mosaic_of_one_colour()
    inner = to_bgr(image, "bayer_rggb8")[4:-4, 4:-4].reshape(-1, 3)
    assert np.unique(inner, axis=0).tolist() == [[BLUE, GREEN, RED]]
    network = to_rgb224(image, "bayer_rggb8").reshape(3, -1)
    expected = np.array([[RED], [GREEN], [BLUE]]) / 255
    np.testing.assert_allclose(network, np.broadcast_to(expected, network.shape), rtol=1e-6)


def test_grey_weighs_the_channels_as_the_eye_does() -> None:
    grey = to_grey(mosaic_of_one_colour(), "bayer_rggb8")
    assert np.unique(grey[4:-4, 4:-4]).tolist() == [round(0.299 * 200 + 0.587 * 100 + 0.114 * 20)]


def test_a_coloured_edge_keeps_its_place() -> None:
    image = mosaic_of_one_colour(64, 64)
    image[:, 32:] = 0
    picture = to_bgr(image, "bayer_rggb8")
    assert picture[8:-8, 4:28, 2].min() == RED
    assert picture[8:-8, 36:].max() == 0


@pytest.mark.parametrize(
    ("height_px", "width_px"), [(1536, 2048), (480, 640), (240, 320), (450, 602), (2, 2), (6, 448)]
)
def test_the_network_picture_is_the_exact_area_average(height_px: int, width_px: int) -> None:
    image = np.random.default_rng(1).integers(0, 256, (height_px, width_px), dtype=np.uint8)
    wide = image.astype(np.float64) / 255
    green = (wide[0::2, 1::2] + wide[1::2, 0::2]) / 2
    planes = [wide[0::2, 0::2], green, wide[1::2, 1::2]]
    picture = to_rgb224(image, "bayer_rggb8")
    assert picture.dtype == np.float32
    np.testing.assert_allclose(
        picture, np.stack([area_average(plane, 224) for plane in planes]), atol=1e-6
    )


def test_a_mono_picture_is_the_same_in_all_channels() -> None:
    image = np.random.default_rng(2).integers(0, 256, (241, 333), dtype=np.uint8)
    picture = to_rgb224(image, "mono8")
    np.testing.assert_allclose(picture[0], area_average(image / 255, 224), atol=1e-6)
    assert np.array_equal(picture[0], picture[1])
    assert np.array_equal(picture[0], picture[2])
    assert to_grey(image, "mono8") is image
    assert np.array_equal(to_bgr(image, "mono8")[..., 1], image)


@pytest.mark.parametrize("value", [0, 255])
def test_black_and_white_stay_in_range(value: int) -> None:
    picture = to_rgb224(np.full((1536, 2048), value, np.uint8), "bayer_rggb8")
    np.testing.assert_allclose(picture, value / 255, atol=1e-6)


@pytest.mark.parametrize(
    ("shape", "pixel_format"),
    [((3, 4), "bayer_rggb8"), ((4, 5), "bayer_rggb8"), ((0, 4), "mono8")],
)
def test_a_broken_mosaic_is_refused(shape: tuple[int, int], pixel_format: PixelFormat) -> None:
    with pytest.raises(ValueError, match="whole groups"):
        to_rgb224(np.zeros(shape, np.uint8), pixel_format)
