"""Procedural albedo textures and their mip-mapped atlas."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Rng = np.random.Generator

MACRO = "macro"
_LETTERS = list("ABCEKMRSXZ0279#")


@dataclass(frozen=True, slots=True, eq=False)
class Atlas:
    """All textures of a world, flat, each with its mip levels one after the other.

    `table` has a row per texture: offset of level 0, log2 width, log2 height, number of levels.
    `mean` is each texture's mean albedo.
    """

    names: tuple[str, ...]
    texels: Image
    table: NDArray[np.int64]
    mean: NDArray[np.float64]

    def index(self, name: str) -> int:
        """Return the row of a texture; raises KeyError for an unknown name."""
        if name not in self.names:
            raise KeyError(name)
        return self.names.index(name)


def make_atlas(images: Mapping[str, Image]) -> Atlas:
    """Build the mip levels; sides must be powers of two. The first texture is the macro layer.

    Row 0 of the atlas is the bottom of a picture, as height runs upwards.
    """
    levels: list[Image] = []
    rows: list[tuple[int, int, int, int]] = []
    offset = 0
    for name, image in images.items():
        height, width = image.shape
        if width & (width - 1) or height & (height - 1):
            raise ValueError(f"texture {name}: sides must be powers of two, got {width}x{height}")
        chain = _mip_levels(np.ascontiguousarray(image[::-1], np.float32))
        rows.append((offset, width.bit_length() - 1, height.bit_length() - 1, len(chain)))
        offset += sum(level.size for level in chain)
        levels.extend(level.ravel() for level in chain)
    means = np.array([float(image.mean()) for image in images.values()])
    return Atlas(tuple(images), np.concatenate(levels), np.array(rows, np.int64), means)


def _mip_levels(image: Image) -> list[Image]:
    chain = [image]
    while min(chain[-1].shape) > 1:
        a = chain[-1]
        half = (a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2]) * np.float32(0.25)
        chain.append(half)
    return chain


def noise(rng: Rng, height: int, width: int, beta: float) -> Image:
    """Return seamless noise with an amplitude spectrum 1/f^beta, stretched to 0..1."""
    fy = np.fft.fftfreq(height)[:, None] * height
    fx = np.fft.rfftfreq(width)[None, :] * width
    frequency = np.hypot(fy, fx)
    frequency[0, 0] = 1.0
    spectrum = np.fft.rfft2(rng.standard_normal((height, width))) / frequency**beta
    field = np.fft.irfft2(spectrum, (height, width))
    low, high = np.percentile(field[::4, ::4], [1, 99])
    return cast(Image, np.clip((field - low) / (high - low), 0, 1).astype(np.float32))


def street_textures(rng: Rng) -> dict[str, Image]:
    """Return every texture of a street and its tunnel, linear albedo in 0..1."""
    makers: dict[str, Callable[[Rng], Image]] = {
        MACRO: lambda r: noise(r, 512, 512, 1.0),
        "asphalt": _asphalt,
        "concrete": _concrete,
        "brick": _brick,
        "pavers": _pavers,
        "grass": lambda r: 0.09 + 0.1 * noise(r, 512, 512, 0.45) * noise(r, 512, 512, 0.9),
        "foliage": lambda r: 0.07 + 0.2 * noise(r, 512, 512, 0.55) ** 2,
        "leaves": _leaf_mask,
        "paint": lambda r: 0.5 * (0.82 + 0.2 * noise(r, 256, 256, 0.8)),
        "dark": lambda r: 0.08 + 0.06 * noise(r, 256, 256, 0.9),
        "metal": lambda r: 0.3 + 0.08 * noise(r, 256, 256, 1.1),
        "blank": lambda r: np.full((4, 4), 0.8, np.float32),
    }
    makers |= {f"facade{k}": _facade for k in range(4)}
    makers |= {f"sign{k}": _sign for k in range(6)}
    makers |= {f"car{k}": _car_side for k in range(3)}
    made = {name: make(rng) for name, make in makers.items()}
    made |= {f"car{k}-end": _car_end(made[f"car{k}"]) for k in range(3)}
    return {name: np.clip(image, 0.012, 1.0).astype(np.float32) for name, image in made.items()}


def _asphalt(rng: Rng) -> Image:
    grain = 0.5 * noise(rng, 1024, 1024, 0.35) + 0.5 * noise(rng, 1024, 1024, 1.1)
    stones = (rng.random((1024, 1024)) > 0.995).astype(np.float32)
    stones = np.clip(cv2.GaussianBlur(stones, (0, 0), 1.0) * 8, 0, 1)
    return cast(Image, (0.08 + 0.05 * grain + 0.07 * stones) * _cracks(rng, 8, 120))


def _cracks(rng: Rng, count: int, steps: int) -> Image:
    canvas = np.ones((1024, 1024), np.float32)
    for _ in range(count):
        turn = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.35, steps))
        walk = rng.uniform(0, 1024, 2) + 4 * np.cumsum(np.stack([np.cos(turn), np.sin(turn)], 1), 0)
        cv2.polylines(canvas, [walk.astype(np.int32)], False, 0.35, 2)
    return canvas


def _concrete(rng: Rng) -> Image:
    c = 0.25 + 0.07 * noise(rng, 1024, 1024, 0.4) + 0.07 * noise(rng, 1024, 1024, 1.3)
    for at in range(0, 1024, 128):
        c[at : at + 3] *= 0.7
    for at in range(0, 1024, 256):
        c[:, at : at + 3] *= 0.7
    for _ in range(24):
        centre = tuple(int(v) for v in rng.integers(0, 1024, 2))
        axes = (int(rng.integers(2, 30)), int(rng.integers(10, 160)))
        cv2.ellipse(c, centre, axes, 0, 0, 360, rng.uniform(0.15, 0.4), 1)
    for _ in range(6):
        where = (int(rng.integers(0, 900)), int(rng.integers(200, 1000)))
        _write(c, rng, where, rng.uniform(0.8, 3.0), rng.uniform(0.05, 0.55), 4)
    return c


def _brick(rng: Rng) -> Image:
    wall = np.full((512, 512), 0.32, np.float32)
    for row in range(16):
        shift = 32 * (row % 2)
        for column in range(8):
            x, y = (column * 64 + shift) % 512, row * 32
            cv2.rectangle(wall, (x + 2, y + 2), (x + 61, y + 29), rng.uniform(0.17, 0.26), -1)
    return cast(Image, wall * (0.85 + 0.3 * noise(rng, 512, 512, 0.6)))


def _pavers(rng: Rng) -> Image:
    slabs = rng.uniform(0.25, 0.31, (8, 8)).astype(np.float32).repeat(64, 0).repeat(64, 1)
    for at in range(0, 512, 64):
        slabs[at : at + 2] *= 0.65
        slabs[:, at : at + 2] *= 0.65
    return cast(Image, slabs * (0.82 + 0.36 * noise(rng, 512, 512, 0.4)))


def _facade(rng: Rng) -> Image:
    wall = rng.uniform(0.3, 0.5) * (0.88 + 0.14 * noise(rng, 1024, 1024, 0.6))
    if rng.random() < 0.5:
        wall *= cv2.resize(_brick(rng), (1024, 1024)) * 3.0
    rows, columns = (int(v) for v in rng.integers(3, 7, 2))
    high, wide = 600 // rows, 560 // columns
    for i in range(rows):
        for j in range(columns):
            y, x = int((i + 0.22) * 1024 / rows), int((j + 0.22) * 1024 / columns)
            wall[y - 8 : y + high + 8, x - 8 : x + wide + 8] = rng.uniform(0.4, 0.7)
            glass = rng.uniform(0.1, 0.22) * (1 + 0.6 * noise(rng, high, wide, 1.2))
            wall[y : y + high, x : x + wide] = glass
            cv2.line(wall, (x + wide // 2, y), (x + wide // 2, y + high), 0.55, 5)
            cv2.line(wall, (x, y + high // 2), (x + wide, y + high // 2), 0.55, 5)
    return cast(Image, wall)


def _leaf_mask(rng: Rng) -> Image:
    y, x = np.mgrid[0:256, 0:256]
    radius = np.hypot((x - 128) / 125, (y - 128) / 125)
    field = noise(rng, 256, 256, 1.3) + 0.35 * noise(rng, 256, 256, 0.6)
    return cast(Image, (field > 0.35 + 0.75 * radius**2).astype(np.float32))


def _sign(rng: Rng) -> Image:
    plate = np.full((256, 256), rng.uniform(0.1, 0.5), np.float32)
    cv2.rectangle(plate, (10, 10), (245, 245), rng.uniform(0.3, 0.75), 8)
    for line in range(3):
        _write(plate, rng, (14, 80 + 60 * line), 3.0, 0.7, 5)
    return plate


def _car_side(rng: Rng) -> Image:
    body = rng.uniform(0.12, 0.6) * (0.85 + 0.25 * noise(rng, 256, 512, 1.3))
    cv2.rectangle(body, (80, 20), (430, 110), 0.12, -1)
    cv2.line(body, (250, 20), (250, 250), 0.1, 8)
    for x in (110, 400):
        cv2.circle(body, (x, 215), 46, 0.06, -1)
        cv2.circle(body, (x, 215), 22, 0.4, -1)
    cv2.rectangle(body, (0, 110), (24, 140), 0.7, -1)
    return cast(Image, body)


def _car_end(side: Image) -> Image:
    """Return a front or rear in the paint of a side."""
    body = np.full((256, 256), np.median(side), np.float32)
    cv2.rectangle(body, (28, 16), (228, 110), 0.12, -1)
    cv2.rectangle(body, (0, 192), (256, 226), 0.1, -1)
    cv2.rectangle(body, (92, 170), (164, 190), 0.7, -1)
    for x in (8, 204):
        cv2.rectangle(body, (x, 126), (x + 44, 156), 0.65, -1)
        cv2.rectangle(body, (x, 226), (x + 44, 256), 0.06, -1)
    return body


def _write(
    image: Image, rng: Rng, where: tuple[int, int], scale: float, value: float, thickness: int
) -> None:
    word = "".join(rng.choice(_LETTERS, 5))
    ink = np.zeros(image.shape, np.uint8)
    cv2.putText(ink, word, where, cv2.FONT_HERSHEY_SIMPLEX, scale, 255, thickness)
    image[ink > 127] = value
