"""Textures of rooms: walls, floors, ceilings, furniture, and what hangs on walls."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import cv2
import numpy as np

from rig.drivers.scenes import photographs
from rig.drivers.scenes.textures import MACRO, Image, Rng, noise, street_textures

_OUTSIDE = (
    MACRO, "leaves", "foliage", "concrete", "pavers", "brick", "asphalt", "metal", "dark", "blank",
    "facade0", "facade1", "facade2", "facade3",
)  # fmt: skip
_WORDS = ("NOTICE", "EXIT", "LAB 214", "ROOM", "SEMINAR", "WELCOME", "SAFETY", "OFFICE", "PLEASE")

POSTERS, SHELVES = 8, 3


def room_textures(rng: Rng) -> dict[str, Image]:
    """Return every texture of a building and what stands around it, linear albedo in 0..1."""
    street = street_textures(rng)
    makers: dict[str, Callable[[Rng], Image]] = {
        "plaster": _plaster,
        "ceiling": _ceiling_tiles,
        "linoleum": _linoleum,
        "tiles": _tiles,
        "carpet": lambda r: 0.08 + 0.1 * noise(r, 512, 512, 0.3) + 0.05 * noise(r, 512, 512, 1.0),
        "parquet": _parquet,
        "wood": _wood,
        "door": _door,
        "steel": lambda r: 0.42 + 0.06 * noise(r, 256, 256, 1.2),
        "plastic": lambda r: 0.05 + 0.03 * noise(r, 256, 256, 1.0),
        "whiteboard": _whiteboard,
        "notices": _notices,
        "screen": _screen,
        "keyboard": _keyboard,
        "cloth": lambda r: 0.2 + 0.15 * noise(r, 256, 256, 0.4),
    }
    makers |= {f"poster{k}": _poster for k in range(POSTERS)}
    makers |= {f"shelf{k}": _shelf for k in range(SHELVES)}
    made = {name: make(rng) for name, make in makers.items()}
    taken = {
        "grass": photographs.ground("grass", 0.14),
        "gravel": photographs.ground("gravel", 0.3),
    }
    everything = {name: street[name] for name in _OUTSIDE} | made | taken
    return {
        name: np.clip(image, 0.012, 0.95, dtype=np.float32) for name, image in everything.items()
    }


def _plaster(rng: Rng) -> Image:
    wall = 0.9 + 0.06 * noise(rng, 1024, 1024, 0.4) + 0.03 * noise(rng, 1024, 1024, 1.2)
    for _ in range(40):
        x, y = (int(v) for v in rng.integers(0, 1000, 2))
        end = (x + int(rng.integers(-40, 40)), y + int(rng.integers(-9, 9)))
        cv2.line(wall, (x, y), end, float(rng.uniform(0.6, 0.9)), 1)
    return cast(Image, wall)


def _ceiling_tiles(rng: Rng) -> Image:
    """Draw 4 x 4 mineral-fibre tiles with their holes and rails."""
    tile = 0.78 + 0.05 * noise(rng, 1024, 1024, 0.4)
    holes = rng.integers(0, 1024, (9000, 2))
    tile[holes[:, 0], holes[:, 1]] *= 0.55
    for at in range(0, 1024, 256):
        tile[at : at + 5] = 0.9
        tile[:, at : at + 5] = 0.9
        tile[at + 5 : at + 7] *= 0.6
        tile[:, at + 5 : at + 7] *= 0.6
    return cast(Image, tile)


def _linoleum(rng: Rng) -> Image:
    floor = 0.3 + 0.08 * noise(rng, 1024, 1024, 0.9)
    chips = noise(rng, 1024, 1024, 0.55)
    floor += 0.16 * (chips > 0.72) - 0.13 * (chips < 0.25)
    for _ in range(25):
        x, y = (int(v) for v in rng.integers(0, 1000, 2))
        size = (int(rng.integers(4, 40)), int(rng.integers(2, 8)))
        cv2.ellipse(floor, (x, y), size, float(rng.uniform(0, 180)), 0, 360, 0.16, 1)
    return cast(Image, floor)


def _tiles(rng: Rng) -> Image:
    shades = rng.uniform(0.4, 0.5, (4, 4)).astype(np.float32).repeat(256, 0).repeat(256, 1)
    floor = shades * (0.8 + 0.35 * noise(rng, 1024, 1024, 0.8))
    for at in range(0, 1024, 256):
        floor[at : at + 6] = 0.2
        floor[:, at : at + 6] = 0.2
    return cast(Image, floor)


def _grain(rng: Rng, height: int, width: int) -> Image:
    """Return wood grain along the first axis, about 1."""
    streaks = cv2.resize(noise(rng, 64, 1024, 0.5), (width, height), interpolation=cv2.INTER_CUBIC)
    rings = noise(rng, 512, 512, 1.4)
    waves = 0.5 + 0.5 * np.sin(40 * cv2.resize(rings, (width, height)))
    return cast(Image, (0.75 + 0.3 * streaks + 0.15 * waves).astype(np.float32))


def _wood(rng: Rng) -> Image:
    return cast(Image, 0.3 * _grain(rng, 512, 512))


def _parquet(rng: Rng) -> Image:
    floor = 0.25 * _grain(rng, 1024, 1024)
    for column in range(8):
        left = column * 128
        start = int(rng.integers(0, 512))
        for top in (start - 512, start, start + 512):
            block = np.s_[max(top, 0) : max(top + 512, 0), left : left + 128]
            floor[block] = np.roll(floor[block], int(rng.integers(0, 128)), 1)
            floor[block] *= float(rng.uniform(0.75, 1.2))
            if 0 <= top < 1022:
                floor[top : top + 3, left : left + 128] = 0.05
        floor[:, left : left + 2] = 0.05
    return cast(Image, floor)


def _door(rng: Rng) -> Image:
    """Draw a door leaf: wood or paint, panels or a pane, handle and lock at its right."""
    leaf = float(rng.uniform(0.25, 0.6)) * _grain(rng, 512, 256)
    cv2.rectangle(leaf, (4, 4), (251, 507), float(leaf.mean() * 0.7), 3)
    if rng.random() < 0.5:
        for low, high in ((40, 210), (290, 460)):
            cv2.rectangle(leaf, (45, low), (210, high), float(leaf.mean() * 0.6), 5)
            cv2.rectangle(leaf, (50, low + 5), (205, high - 5), float(leaf.mean() * 1.3), 2)
    else:
        cv2.rectangle(leaf, (100, 60), (155, 250), 0.1, -1)
        cv2.rectangle(leaf, (98, 58), (157, 252), 0.5, 3)
    cv2.rectangle(leaf, (215, 262), (240, 272), 0.65, -1)
    cv2.circle(leaf, (236, 290), 4, 0.05, -1)
    return cast(Image, leaf)


def _poster(rng: Rng) -> Image:
    sheet = np.full((512, 512), float(rng.uniform(0.55, 0.85)), np.float32)
    sheet *= 0.97 + 0.03 * noise(rng, 512, 512, 0.8)
    _letters(sheet, rng, (20, 70), 1.9, float(rng.uniform(0.03, 0.25)), 5)
    top = int(rng.integers(95, 150))
    picture = noise(rng, 256, 512, float(rng.uniform(0.7, 1.5)))[: 330 - top]
    sheet[top:330, 24:488] = (0.05 + 0.7 * picture[:, 24:488]).astype(np.float32)
    for _ in range(int(rng.integers(2, 6))):
        centre = (int(rng.integers(60, 450)), int(rng.integers(top + 30, 300)))
        cv2.circle(sheet, centre, int(rng.integers(8, 45)), float(rng.uniform(0.03, 0.8)), -1)
    _text(sheet, rng, 24, 488, 355, 495)
    cv2.rectangle(sheet, (0, 0), (511, 511), float(rng.uniform(0.03, 0.7)), 6)
    return cast(Image, sheet)


def _text(sheet: Image, rng: Rng, left: int, right: int, top: int, bottom: int) -> None:
    """Fill a part of a sheet with lines of words that are too small to read."""
    for y in range(top, bottom, 14):
        x = left
        end = right - int(rng.integers(0, 120))
        while x < end:
            wide = int(rng.integers(8, 40))
            cv2.rectangle(sheet, (x, y), (min(x + wide, end), y + 5), 0.12, -1)
            x += wide + 7


def _notices(rng: Rng) -> Image:
    board = 0.2 + 0.12 * noise(rng, 512, 1024, 0.2)
    for _ in range(22):
        x, y = int(rng.integers(10, 900)), int(rng.integers(10, 400))
        wide, high = int(rng.integers(60, 120)), int(rng.integers(70, 110))
        right, low = min(x + wide, 1020), min(y + high, 508)
        board[y:low, x:right] = float(rng.uniform(0.35, 0.85))
        _text(board, rng, x + 6, right - 6, y + 22, low - 10)
        cv2.rectangle(board, (x + 6, y + 6), (x + wide // 2, y + 14), 0.08, -1)
    cv2.rectangle(board, (0, 0), (1023, 511), 0.35, 14)
    return cast(Image, board)


def _whiteboard(rng: Rng) -> Image:
    board = 0.8 + 0.04 * noise(rng, 512, 1024, 1.4)
    for _ in range(6):
        x, y = int(rng.integers(30, 600)), int(rng.integers(60, 420))
        _letters(board, rng, (x, y), float(rng.uniform(0.8, 1.8)), 0.1, 2)
    for _ in range(5):
        corners = rng.integers((30, 40), (980, 470), (2, 2))
        first, second = (tuple(int(v) for v in corner) for corner in corners)
        if rng.random() < 0.5:
            cv2.rectangle(board, first, second, 0.15, 2)
        else:
            cv2.arrowedLine(board, first, second, 0.12, 3, tipLength=0.06)
    curve = np.stack([np.arange(100, 500, 4), 260 + 60 * np.sin(np.arange(100) / 9.0)], 1)
    cv2.polylines(board, [curve.astype(np.int32)], False, 0.2, 3)
    cv2.rectangle(board, (0, 0), (1023, 511), 0.4, 12)
    return cast(Image, board)


def _shelf(rng: Rng) -> Image:
    """Draw a bookcase with five boards of books."""
    case = np.full((512, 512), 0.05, np.float32)
    for row in range(5):
        low = (row + 1) * 102
        x = 8
        while x < 496:
            wide = int(rng.integers(7, 24))
            if rng.random() < 0.9:
                top = low - int(rng.integers(58, 92))
                shade = float(rng.uniform(0.05, 0.75))
                cv2.rectangle(case, (x, top), (min(x + wide - 2, 500), low), shade, -1)
                mark = top + int(rng.integers(8, 35))
                cv2.rectangle(case, (x + 2, mark), (x + wide - 4, mark + 12), 0.8 - shade, -1)
            x += wide
        case[low - 2 : low + 6] = 0.4
    cv2.rectangle(case, (0, 0), (511, 511), 0.38, 14)
    return cast(Image, case)


def _screen(rng: Rng) -> Image:
    display = np.full((256, 512), 0.03, np.float32)
    cv2.rectangle(display, (14, 12), (497, 240), 0.12, -1)
    _text(display, rng, 30, 470, 30, 225)
    cv2.rectangle(display, (0, 0), (511, 255), 0.06, 12)
    return cast(Image, display)


def _keyboard(rng: Rng) -> Image:
    desk = 0.35 * _grain(rng, 512, 512)
    desk[300:400, 60:330] = 0.06
    for row in range(5):
        for column in range(15):
            x, y = 66 + column * 17, 306 + row * 18
            desk[y : y + 14, x : x + 13] = 0.22
    for _ in range(4):
        corner = rng.integers(20, 400, 2).astype(np.float32)
        size = (float(rng.uniform(60, 110)), float(rng.uniform(80, 140)))
        middle = (float(corner[0]) + 50, float(corner[1]) + 50)
        sheet = cv2.boxPoints((middle, size, float(rng.uniform(0, 90))))
        cv2.fillConvexPoly(desk, sheet.astype(np.int32), float(rng.uniform(0.5, 0.8)))
    return cast(Image, desk)


def _letters(
    image: Image, rng: Rng, where: tuple[int, int], scale: float, value: float, thickness: int
) -> None:
    word = str(rng.choice(_WORDS))
    ink = np.zeros(image.shape, np.uint8)
    cv2.putText(ink, word, where, cv2.FONT_HERSHEY_SIMPLEX, scale, 255, thickness)
    image[ink > 127] = value
