"""The metrics equal their equations, computed slowly and independently."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import convolve2d

from rig.vision.metrics import entropy_bits, mean_dn, shim_gradient, shin

Picture = NDArray[np.uint8]
SOBEL_X = np.array([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]])
NOISE_KERNEL = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]])


def scene(seed: int, channels: int = 1, noise_dn: float = 2.0) -> Picture:
    """Return rectangles on a ramp with noise: edges, flat parts and saturated parts."""
    rng = np.random.default_rng(seed)
    picture = np.tile(np.linspace(0, 200, 91), (73, 1))[..., None] * np.ones(channels)
    for _ in range(25):
        y, x = rng.integers(0, 60), rng.integers(0, 80)
        picture[y : y + rng.integers(3, 30), x : x + rng.integers(3, 30)] = rng.uniform(
            0, 300, channels
        )
    picture += rng.normal(0, noise_dn, picture.shape)
    return np.clip(picture, 0, 255).astype(np.uint8).squeeze()


def gradient(grey: NDArray[np.float64]) -> NDArray[np.float64]:
    across = convolve2d(grey, SOBEL_X, mode="valid")
    down = convolve2d(grey, SOBEL_X.T, mode="valid")
    return np.sqrt(across**2 + down**2) / math.sqrt(2 * 16 * 255**2)


def information(magnitude: NDArray[np.float64]) -> NDArray[np.float64]:
    scaled = np.log(1000 * np.maximum(magnitude - 0.06, 0) + 1) / math.log(1000 * 0.94 + 1)
    return np.where(magnitude >= 0.06, scaled, 0.0)


def cell_means(values: NDArray[np.float64]) -> NDArray[np.float64]:
    height, width = values.shape
    return np.array(
        [
            values[
                row * height // 10 : (row + 1) * height // 10,
                column * width // 10 : (column + 1) * width // 10,
            ].mean()
            for row in range(10)
            for column in range(10)
        ]
    )


def entropy(grey: NDArray[np.float64]) -> float:
    shares = [float((grey == level).mean()) for level in range(256)]
    return -sum(share * math.log2(share) for share in shares if share > 0)


def noise(
    channel: NDArray[np.float64], homogeneous: NDArray[np.bool_], divisor: float
) -> tuple[float, int]:
    inner = channel[1:-1, 1:-1]
    mask = homogeneous & (inner >= 15) & (inner <= 235)
    response = np.abs(convolve2d(channel, NOISE_KERNEL, mode="valid"))
    total = math.sqrt(math.pi / 2) * float(response[mask].sum())
    return total / (divisor * max(int(mask.sum()), 1)), int(mask.sum())


def slow_shin(picture: Picture, variant: str, stride: int) -> tuple[float, float, float, float]:
    colour = picture.ndim == 3
    grey_u8 = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if colour else picture
    grey = np.asarray(grey_u8, np.float64)
    magnitude = gradient(grey)
    sampled = magnitude[::stride, ::stride]
    cells = cell_means(information(sampled))
    lowest = np.sort(sampled.ravel())[int(0.1 * sampled.size)]
    limit = 0.06 if variant == "thesis" else lowest
    homogeneous = np.zeros(magnitude.shape, bool)
    homogeneous[::stride, ::stride] = sampled <= limit
    divisor = 1.0 if variant == "thesis" else 6.0
    channels = picture if colour else picture[..., None]
    found = [
        noise(channels[..., k].astype(np.float64), homogeneous, divisor)
        for k in range(channels.shape[2])
    ]
    unknown = variant == "authors-cpp"
    levels = [20.0 if unknown and count <= 10 else level for level, count in found]
    weights = [0.25, 0.5, 0.25] if variant == "authors-cpp" else [1 / 3] * 3
    noise_dn = float(np.dot(levels, weights if colour else [1.0]))
    spread = cells.std(ddof=1 if variant == "authors" else 0)
    unevenness = (1.0 if variant == "authors-cpp" else 2.0) * cells.mean() / spread
    bits = entropy(grey[1:-1:stride, 1:-1:stride])
    alpha = 0.5 if variant == "authors-cpp" else 0.4
    score = alpha * unevenness + (1 - alpha) * bits / 8 - 0.4 * noise_dn
    return float(score), float(unevenness), bits / 8, noise_dn


@pytest.mark.parametrize("variant", ["authors", "authors-cpp", "thesis"])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("stride", [1, 3])
def test_shin_equals_its_equations(variant: str, channels: int, stride: int) -> None:
    picture = scene(7, channels)
    fast = shin(picture, variant, stride)
    assert (fast.score, fast.gradient, fast.entropy, fast.noise_dn) == pytest.approx(
        slow_shin(picture, variant, stride), rel=2e-5
    )
    assert not fast.flat


def test_noise_of_a_known_deviation_is_found() -> None:
    flat = np.full((400, 400), 120.0) + np.random.default_rng(1).normal(0, 5, (400, 400))
    picture = np.clip(flat.round(), 0, 255).astype(np.uint8)
    everywhere = shin(picture, "thesis").noise_dn / 6
    assert everywhere == pytest.approx(5.0, rel=0.03)


def test_gain_noise_lowers_the_score() -> None:
    scores = [shin(scene(7, 3, noise_dn), "authors").score for noise_dn in (1.0, 4.0, 12.0)]
    assert scores == sorted(scores, reverse=True)


def test_a_stride_estimates_the_full_score() -> None:
    large = cv2.resize(scene(3, 1, 0.0), (910, 730), interpolation=cv2.INTER_CUBIC)
    noisy = large + np.random.default_rng(2).normal(0, 3, large.shape)
    picture = np.clip(noisy, 0, 255).astype(np.uint8)
    full, sampled = shin(picture), shin(picture, stride=3)
    assert sampled.entropy == pytest.approx(full.entropy, rel=0.02)
    assert sampled.noise_dn == pytest.approx(full.noise_dn, rel=0.1)
    assert sampled.gradient == pytest.approx(full.gradient, rel=0.1)


@pytest.mark.parametrize("value", [0, 128, 255])
@pytest.mark.parametrize(
    ("variant", "expected"),
    [("authors", 0.0), ("authors-cpp", {0: -3.0, 128: 5.0, 255: -3.0}), ("thesis", 0.0)],
)
def test_a_flat_picture_has_finite_terms(
    value: int, variant: str, expected: float | dict[int, float]
) -> None:
    result = shin(np.full((40, 50, 3), value, np.uint8), variant)
    assert result.flat
    assert result.score == pytest.approx(
        expected[value] if isinstance(expected, dict) else expected
    )


def test_a_saturated_picture_is_measured_everywhere() -> None:
    picture = np.full((60, 60), 250, np.uint8)
    picture[::2, ::2] = 252
    assert shin(picture, "authors").noise_dn == pytest.approx(math.sqrt(math.pi / 2) * 8 / 6)


def test_a_picture_smaller_than_the_grid_is_refused() -> None:
    assert shin(scene(1)[:12, :12]).score == pytest.approx(
        slow_shin(scene(1)[:12, :12], "authors", 1)[0], rel=2e-5
    )
    for picture, stride in ((scene(1)[:11], 1), (scene(1)[:20], 2), (scene(1)[:2], 1)):
        with pytest.raises(ValueError, match="too small"):
            shin(picture, stride=stride)


def test_entropy_counts_bits() -> None:
    assert entropy_bits(np.zeros((8, 8), np.uint8)) == 0
    assert entropy_bits(np.arange(256, dtype=np.uint8).reshape(16, 16)) == pytest.approx(8)
    assert entropy_bits(scene(4)) == pytest.approx(entropy(scene(4).astype(np.float64)))


def test_shim_gradient_is_the_summed_information() -> None:
    grey = scene(5)
    expected = information(gradient(grey.astype(np.float64))).sum()
    assert shim_gradient(grey) == pytest.approx(expected, rel=2e-5)


def test_mean() -> None:
    assert mean_dn(np.array([[0, 1], [2, 5]], np.uint8)) == 2.0


@pytest.mark.parametrize("shape", [(240, 320), (480, 640), (1536, 2048)])
def test_a_white_picture_is_not_brighter_than_white(shape: tuple[int, int]) -> None:
    assert mean_dn(np.full(shape, 255, np.uint8)) == 255.0
