"""One moment of a simulated drive, taken with every setting of a grid, for a person to look at."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.core.errors import RecordingError, UsageError
from rig.core.types import Settings
from rig.drivers.addresses import parse_address
from rig.drivers.registry import open_source
from rig.drivers.simulated.program import round_settings
from rig.drivers.simulated.source import SimulatedSource, photographer
from rig.vision.bayer import to_bgr

Picture = NDArray[np.uint8]

_THUMB_PX = 240
_LABEL_PX = 18
_SATURATED_DN = 255


@dataclass(frozen=True, slots=True)
class Look:
    """One picture: its file, the pair and settings it was taken with, and how bright it is.

    `saturated` is the share of pixels at full scale, 0..1.
    """

    file: str
    pair: int
    exposure_us: float
    gain_db: float
    mean_dn: float
    saturated: float


@dataclass(frozen=True, slots=True)
class Looks:
    """All pictures of a run; a contact sheet a pair."""

    cameras: str
    world_version: str
    pictures: tuple[Look, ...]
    contact_sheets: tuple[str, ...]


def take_looks(
    address: str,
    folder: Path,
    exposures_us: Sequence[float],
    gains_db: Sequence[float],
    pairs: Sequence[int],
    *,
    seed: int,
    progress: Callable[[int], None],
) -> Looks:
    """Take the primary's picture of each pair with each exposure and gain, into a new `folder`.

    The pictures are what the camera gives, in colour; on a contact sheet exposures go across and
    gains down, brightened by the sRGB curve. Raises UsageError for an address that is no simulation
    in this process, a setting that the camera cannot take, or a pair after the drive.
    """
    if parse_address(address).scheme != "sim":
        raise UsageError(f"{address}: only a simulation can be looked at; try sim:tunnel")
    with closing(open_source(address, seed=seed)) as source:
        assert isinstance(source, SimulatedSource)
        for pair in pairs:
            if not 0 <= pair < source.drive_triggers:
                raise UsageError(
                    f"pair {pair}: {address} has pairs 0 to {source.drive_triggers - 1}"
                )
        grid = [[_settings(source, e, g) for e in exposures_us] for g in gains_db]
        folder.mkdir(parents=True)
        take = photographer(source.scene, "primary", source.drive)
        pixel_format = source.drive.model.picture.format
        found: list[Look] = []
        sheets: list[str] = []
        for pair in pairs:
            rows: list[list[Picture]] = []
            for settings_row in grid:
                rows.append([])
                for settings in settings_row:
                    mosaic = take(pair, settings)
                    picture = to_bgr(mosaic, pixel_format)
                    name = _name(pair, settings)
                    _save(folder / name, picture)
                    found.append(_look(name, pair, settings, mosaic))
                    rows[-1].append(picture)
                    progress(len(found))
            title = f"SIMULATED {source.world_version} pair {pair}"
            sheets.append(f"contact-{pair:04d}.png")
            _save(folder / sheets[-1], contact_sheet(rows, grid, title))
        return Looks(source.address, source.world_version, tuple(found), tuple(sheets))


def contact_sheet(
    rows: Sequence[Sequence[Picture]], grid: Sequence[Sequence[Settings]], title: str
) -> Picture:
    """Return small pictures in rows of one gain, under their settings, brightened for the eye."""
    lines = []
    for pictures, settings in zip(rows, grid, strict=True):
        cells = [
            _labelled(_small(picture), f"{used.exposure_us:g} us  {used.gain_db:g} dB")
            for picture, used in zip(pictures, settings, strict=True)
        ]
        lines.append(np.hstack(cells))
    sheet = np.vstack(lines)
    return np.asarray(np.vstack([_bar(sheet.shape[1], title), sheet]), np.uint8)


def _settings(source: SimulatedSource, exposure_us: float, gain_db: float) -> Settings:
    """Return settings as the camera rounds them; raises UsageError for what it cannot take."""
    controls = source.drive.model.controls
    limits = controls.limits
    try:
        asked = Settings(exposure_us, gain_db)
    except ValueError as error:
        raise UsageError(str(error)) from error
    if asked.clamp(limits) != asked:
        (e0, e1), (g0, g1) = limits.exposure_us, limits.gain_db
        raise UsageError(
            f"{exposure_us:g} us at {gain_db:g} dB: {source.drive.model.name} takes "
            f"{e0:g} to {e1:g} us and {g0:g} to {g1:g} dB"
        )
    return round_settings(asked, limits, controls)


def _look(name: str, pair: int, used: Settings, mosaic: Picture) -> Look:
    saturated = float((mosaic >= _SATURATED_DN).mean())
    return Look(name, pair, used.exposure_us, used.gain_db, float(mosaic.mean()), saturated)


def _name(pair: int, used: Settings) -> str:
    return f"pair{pair:04d}-{used.exposure_us:g}us-{used.gain_db:g}db.png"


def _small(picture: Picture) -> Picture:
    height, width = picture.shape[:2]
    size = (_THUMB_PX, round(_THUMB_PX * height / width))
    light = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.float64) / 255
    curve = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * curve), np.uint8)


def _labelled(picture: Picture, words: str) -> Picture:
    return np.asarray(np.vstack([_bar(picture.shape[1], words), picture]), np.uint8)


def _bar(width_px: int, words: str) -> Picture:
    bar = np.full((_LABEL_PX, width_px, 3), 32, np.uint8)
    place = (4, _LABEL_PX - 5)
    cv2.putText(bar, words, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (230, 230, 230), 1, cv2.LINE_AA)
    return bar


def _save(path: Path, picture: Picture) -> None:
    done, data = cv2.imencode(".png", picture)
    if not done:
        raise RecordingError(f"{path} cannot be written as a picture")
    path.write_bytes(data.tobytes())
