"""The metrics equal their definitions, computed slowly and independently."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import correlate

from rig.vision.metrics import (
    entropy_bits,
    features,
    gradient_sum,
    kim,
    mean_dn,
    sample,
    sampled_information,
    score,
    shim_gradient,
    shin,
    shin_at,
    zhang_percentile,
    zhang_soft,
)
from rig.vision.metrics.sampling import inner

Picture = NDArray[np.uint8]
Values = NDArray[np.float64]
SOBEL_X = np.array([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]])
SCHARR_X = np.array([[-3, 0, 3], [-10, 0, 10], [-3, 0, 3]]) / 32
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


def opencv_grey(picture: Picture) -> Picture:
    return picture if picture.ndim == 2 else np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))


def gradient(grey: NDArray[Any], mode: str, kernel: Values = SOBEL_X) -> Values:
    values = grey.astype(np.float64)
    return np.hypot(correlate(values, kernel, mode=mode), correlate(values, kernel.T, mode=mode))


def information(magnitude: Values) -> Values:
    scaled = np.log(1000 * np.maximum(magnitude - 0.06, 0) + 1) / math.log(1000 * 0.94 + 1)
    return np.where(magnitude >= 0.06, scaled, 0.0)


def entropy(grey: NDArray[Any]) -> float:
    shares = [float((grey == level).mean()) for level in range(256)]
    return -sum(share * math.log2(share) for share in shares if share > 0)


def evenness(values: Values, lost: int, *, cut: bool) -> float:
    height, width = values.shape
    if cut:
        values = values[: height // 10 * 10, : width // 10 * 10]
        height, width = values.shape
    cells = [
        values[
            row * height // 10 : (row + 1) * height // 10,
            column * width // 10 : (column + 1) * width // 10,
        ].mean()
        for row in range(10)
        for column in range(10)
    ]
    return float(np.mean(cells) / np.std(cells, ddof=lost))


def matlab(picture: Picture) -> float:
    """Score a colour picture as the authors' MATLAB program does."""
    levels = []
    for k in range(3):
        channel = picture[..., k].astype(np.float64)
        squared = gradient(channel, "nearest") ** 2
        limit = np.sort(squared.ravel())[math.floor(0.1 * channel.size + 0.5) - 1]
        mask = (squared <= limit + 1e-6) & (channel >= 15) & (channel <= 235)
        response = np.abs(correlate(channel, NOISE_KERNEL, mode="constant"))
        level = response[mask].sum() / (6 * max(mask.sum(), 1))
        if mask.sum() < channel.size * 1e-4:
            height, width = channel.shape
            level = response.sum() / (6 * (height - 2) * (width - 2))
        levels.append(math.sqrt(math.pi / 2) * level)
    shares = [0.114020904255103, 0.587043074451121, 0.298936021293776]
    grey = np.floor(picture.astype(np.float64) @ shares + 0.5)
    magnitude = gradient(grey, "nearest") / math.sqrt(2 * 16 * 255**2)
    even = evenness(information(magnitude), 1, cut=False)
    return 0.4 * 2 * even + 0.6 * entropy(grey) / 8 - 0.4 * float(np.mean(levels))


def cpp(picture: Picture) -> float:
    """Score a colour picture as the authors' C++ program does."""
    levels = []
    for k in range(3):
        channel = picture[..., k].astype(np.float64)
        magnitude = gradient(channel, "mirror")
        limit = np.sort(magnitude.ravel())[math.floor(0.1 * channel.size + 0.5)]
        mask = (magnitude <= limit + 1e-9) & (channel >= 15) & (channel <= 235)
        response = np.abs(correlate(channel, NOISE_KERNEL, mode="mirror"))
        known = mask.sum() > 10
        level = math.sqrt(math.pi / 2) * response[mask].sum() / (6 * max(mask.sum(), 1))
        levels.append(level if known else 20.0)
    grey = opencv_grey(picture)
    magnitude = gradient(grey, "mirror") / math.sqrt(2 * 16 * 255**2)
    even = evenness(information(magnitude), 0, cut=True)
    noise_dn = (levels[0] + 2 * levels[1] + levels[2]) / 4
    return 0.5 * even + 0.5 * entropy(grey) / 8 - 0.4 * float(noise_dn)


def printed(picture: Picture) -> float:
    """Score a colour picture by the equations that the thesis prints."""
    levels = []
    for k in range(3):
        channel = picture[..., k].astype(np.float64)
        magnitude = gradient(channel, "mirror") / math.sqrt(2 * 16 * 255**2)
        mask = (magnitude <= 0.06) & (channel >= 15) & (channel <= 235)
        response = np.abs(correlate(channel, NOISE_KERNEL, mode="mirror"))
        levels.append(math.sqrt(math.pi / 2) * response[mask].sum() / max(mask.sum(), 1))
    grey = opencv_grey(picture)
    magnitude = gradient(grey, "mirror") / math.sqrt(2 * 16 * 255**2)
    even = evenness(information(magnitude), 0, cut=False)
    return 0.4 * 2 * even + 0.6 * entropy(grey) / 8 - 0.4 * float(np.mean(levels))


@pytest.mark.parametrize(
    ("variant", "slow"), [("authors", matlab), ("authors-cpp", cpp), ("thesis", printed)]
)
@pytest.mark.parametrize("seed", [7, 8, 9])
def test_shin_is_what_each_program_computes(variant: str, slow: Any, seed: int) -> None:
    picture = scene(seed, 3)
    assert shin(picture, variant).score == pytest.approx(slow(picture), abs=2e-5)


@pytest.mark.parametrize("variant", ["authors", "authors-cpp", "thesis"])
def test_a_grey_picture_scores_as_three_equal_channels(variant: str) -> None:
    picture = scene(3)
    colour = np.repeat(picture[..., None], 3, axis=2)
    assert shin(picture, variant).score == pytest.approx(shin(colour, variant).score)


def test_noise_of_a_known_deviation_is_found() -> None:
    flat = np.full((400, 400), 120.0) + np.random.default_rng(1).normal(0, 5, (400, 400))
    picture = np.clip(flat.round(), 0, 255).astype(np.uint8)
    everywhere = shin(picture, "thesis").noise_dn / 6
    assert everywhere == pytest.approx(5.0, rel=0.03)


def test_gain_noise_lowers_the_score() -> None:
    scores = [shin(scene(7, 3, noise_dn), "authors").score for noise_dn in (1.0, 4.0, 12.0)]
    assert scores == sorted(scores, reverse=True)


@pytest.mark.parametrize("size", [(640, 480), (1024, 768), (2048, 1536)])
def test_a_sample_estimates_the_whole(size: tuple[int, int]) -> None:
    smooth = cv2.resize(scene(3, 1, 0.0), size, interpolation=cv2.INTER_CUBIC)
    noisy = smooth + np.random.default_rng(2).normal(0, 3, smooth.shape)
    picture = np.clip(noisy, 0, 255).astype(np.uint8)
    part = sample(picture, "mono8")
    full, sampled = shin(picture), shin_at(part.mosaic, part.places)
    assert sampled.entropy == pytest.approx(full.entropy, rel=0.02)
    assert sampled.noise_dn == pytest.approx(full.noise_dn, rel=0.15)
    assert sampled.gradient == pytest.approx(full.gradient, rel=0.15)
    whole = shim_gradient(picture) / picture.size
    assert sampled_information(part.mosaic, part.places) == pytest.approx(whole, rel=0.15, abs=5e-4)


def test_a_sample_sees_every_place_of_the_mosaic_with_its_true_neighbours() -> None:
    mosaic = np.add.outer(np.arange(480) % 2 * 2, np.arange(640) % 2).astype(np.uint8) * 50
    part = sample(mosaic, "bayer_rggb8")
    seen, counts = np.unique(part.judged(part.mosaic), return_counts=True)
    assert seen.tolist() == [0, 50, 100, 150]
    assert len(set(counts.tolist())) == 1
    flat_colours = part.judged(part.colour()[..., 0])
    assert (flat_colours == 150).all(), "a blue filter's neighbours are those of the full mosaic"


def test_a_small_picture_is_looked_at_as_a_whole() -> None:
    part = sample(scene(1), "mono8")
    assert part.mosaic is not None
    assert part.judged(part.mosaic).shape == (71, 89)


@pytest.mark.parametrize("value", [0, 128, 255])
@pytest.mark.parametrize(
    ("variant", "expected"),
    [("authors", 0.0), ("authors-cpp", {0: -3.0, 128: 5.0, 255: -3.0}), ("thesis", 0.0)],
)
def test_a_flat_picture_has_finite_terms(
    value: int, variant: str, expected: float | dict[int, float]
) -> None:
    picture = np.full((40, 50, 3), value, np.uint8)
    result = shin_at(picture, inner(picture), variant)
    assert result.flat
    assert result.score == pytest.approx(
        expected[value] if isinstance(expected, dict) else expected
    )
    assert math.isfinite(shin(picture, variant).score)


def test_a_saturated_picture_is_measured_everywhere() -> None:
    picture = np.full((60, 60, 3), 250, np.uint8)
    picture[::2, ::2] = 252
    assert shin(picture, "authors").score == pytest.approx(matlab_flat(picture), rel=1e-6)


def matlab_flat(picture: Picture) -> float:
    """Score a picture without gradients: only entropy and noise are left."""
    channel = picture[..., 0].astype(np.float64)
    response = np.abs(correlate(channel, NOISE_KERNEL, mode="constant"))
    noise_dn = math.sqrt(math.pi / 2) * response.sum() / (6 * 58 * 58)
    return 0.6 * entropy(channel) / 8 - 0.4 * noise_dn


def test_a_picture_smaller_than_the_grid_is_refused() -> None:
    assert math.isfinite(shin(scene(1, 3)[:12, :12]).score)
    with pytest.raises(ValueError, match="too small"):
        shin(scene(1)[:9])
    with pytest.raises(ValueError, match="too small"):
        shin_at(scene(1)[:11], inner(scene(1)[:11]))


def test_entropy_counts_bits() -> None:
    assert entropy_bits(np.zeros((8, 8), np.uint8)) == 0
    assert entropy_bits(np.arange(256, dtype=np.uint8).reshape(16, 16)) == pytest.approx(8)
    assert entropy_bits(scene(4)) == pytest.approx(entropy(scene(4)))


def test_gradient_information_and_sum() -> None:
    grey = scene(5)
    magnitude = gradient(grey, "mirror") / math.sqrt(2 * 16 * 255**2)
    assert shim_gradient(grey) == pytest.approx(information(magnitude).sum(), rel=2e-5)
    assert gradient_sum(grey) == pytest.approx(magnitude.sum(), rel=1e-6)


def test_zhang_weighs_the_sorted_squared_gradients() -> None:
    grey = scene(5)
    ordered = np.sort((gradient(grey, "mirror", SCHARR_X) ** 2).ravel())
    first = int(ordered.size * 0.7)
    rising = [math.sin(math.pi / 2 * i / (first - 1)) ** 5 for i in range(first)]
    left = ordered.size - first
    falling = [math.sin(math.pi / 2 - math.pi / 2 * (i + 1) / left) ** 5 for i in range(left)]
    weights = np.array(rising + falling)
    assert zhang_soft(grey) == pytest.approx(float(ordered @ weights / weights.sum()), rel=1e-5)
    assert zhang_percentile(grey) == pytest.approx(float(ordered[first]), rel=1e-5)


def slow_kim(grey: Picture) -> float:
    """Score a picture as the authors' C++ program does, index by index."""
    small = np.asarray(cv2.resize(grey, (320, 240)), np.int64)
    flat = np.pad(small, 2, mode="edge").ravel()
    stride = 324
    entropies = np.zeros((240, 320))
    for y in range(238):
        for x in range(318):
            at = (y + 2) * stride + x
            places = [at + dx + dy * stride for dy in range(-2, 3) for dx in range(-2, 3)]
            counts = np.unique(flat[np.maximum(places, 0)], return_counts=True)[1] / 5
            entropies[y, x] = -(counts * np.log2(counts)).sum()
    stretched = (entropies - entropies.min()) / (entropies.max() - entropies.min())
    wide = np.pad(small, 1, mode="reflect")
    across = np.maximum(wide[1:-1, 2:] - wide[1:-1, :-2], 0)
    down = np.maximum(wide[2:, 1:-1] - wide[:-2, 1:-1], 0)
    strength = np.minimum(np.rint(1.49999 * (across + down)), 255) / 255
    mean = strength.mean()
    strong = strength[strength > 0.3 * mean].sum()
    return float(strong - 5 * mean * (stretched <= 0.001).sum())


def test_kim_is_what_the_program_computes() -> None:
    grey = cv2.resize(scene(6), (400, 300), interpolation=cv2.INTER_NEAREST)
    assert kim(np.asarray(grey, np.uint8)) == pytest.approx(slow_kim(np.asarray(grey)), rel=1e-5)


def test_features_are_counted_and_spread() -> None:
    grey = np.asarray(cv2.resize(scene(6), (640, 480), interpolation=cv2.INTER_NEAREST), np.uint8)
    found = features(grey)
    points = [point.pt for point in cv2.ORB.create(10_000).detect(grey, None)]
    numbers = np.zeros((10, 10))
    for x, y in points:
        numbers[int(y * 10 / 480), int(x * 10 / 640)] += 1
    assert found.count == len(points) > 100
    assert found.uniformity == pytest.approx(numbers.mean() / numbers.std())
    nothing = features(np.full((60, 60), 90, np.uint8))
    assert (nothing.count, nothing.uniformity) == (0, 0.0)


def test_every_score_is_a_finite_number_even_of_flat_pictures() -> None:
    for value in (0, 90, 255):
        scores = score(np.full((60, 80, 3), value, np.uint8))
        assert len(scores) == 11
        assert all(math.isfinite(number) for number in scores.values())


def test_mean() -> None:
    assert mean_dn(np.array([[0, 1], [2, 5]], np.uint8)) == 2.0


@pytest.mark.parametrize("shape", [(240, 320), (480, 640), (1536, 2048)])
def test_a_white_picture_is_not_brighter_than_white(shape: tuple[int, int]) -> None:
    assert mean_dn(np.full(shape, 255, np.uint8)) == 255.0
