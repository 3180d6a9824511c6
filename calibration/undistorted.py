"""A recording as a camera without lens distortion would have taken it."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from rig.calibration.files import check_calibration
from rig.config import Calibration, LensCalibration, parse_calibration
from rig.core.errors import CalibrationError
from rig.core.types import SIDES, Frame, Intrinsics, Lost, Pair, PairRecord
from rig.record.header import RunHeader
from rig.vision.bayer import to_grey
from rig.vision.undistort import Undistorter, scaled


class Recorded(Protocol):
    """What can be undistorted: a header and its records."""

    @property
    def header(self) -> RunHeader:
        """Return what the run was."""
        ...

    def records(self) -> Iterator[PairRecord]:
        """Return the records in order."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Undistorted:
    """Wraps a recording: grey, undistorted frames, and the calibrated intrinsics."""

    recording: Recorded
    header: RunHeader
    lenses: Pair[Undistorter]

    def records(self) -> Iterator[PairRecord]:
        """Return the records in order."""
        for record in self.recording.records():
            shot = Pair(
                *(_flat(shot, lens) for shot, lens in zip(record.shot, self.lenses, strict=True))
            )
            yield dataclasses.replace(record, shot=shot)


def attached_calibration(
    header: RunHeader, file: str, taken: datetime.date
) -> tuple[Calibration | None, list[str]]:
    """Return the calibration that a recording carries, None without one, and warnings about it.

    Raises ConfigError when it is none, CalibrationError when it is not of these cameras and
    lenses, or later than `taken`, the day of the recording.
    """
    if not header.calibration:
        return None, []
    found = parse_calibration(header.calibration.encode(), f"{file}: calibration.toml")
    return found, check_calibration(found, header.serials, header.intrinsics, taken, file)


def undistorted(recording: Recorded, file: str, taken: datetime.date) -> Undistorted:
    """Return the recording undistorted by its own calibration.

    Without a calibration the distortion that the recording states does it, which simulated
    cameras know of themselves. Raises CalibrationError when there is neither, the calibration has
    no intrinsics, or it is not of these cameras; `taken` is the day of the recording.
    """
    header = recording.header
    found, _ = attached_calibration(header, file, taken)
    if found is not None:
        return _flattened(recording, _calibrated(found, header.intrinsics, file))
    if all(any(lens.distortion) for lens in header.intrinsics):
        stated = Pair(*(Undistorter(lens, lens.distortion) for lens in header.intrinsics))
        return _flattened(recording, stated)
    raise CalibrationError(
        f"{file}: no calibration is attached, so nothing can be undistorted; record with "
        "--calibration FILE, or judge without --undistort"
    )


def _calibrated(found: Calibration, stated: Pair[Intrinsics], file: str) -> Pair[Undistorter]:
    lenses = []
    for side, lens, of_source in zip(SIDES, (found.primary, found.secondary), stated, strict=True):
        if lens is None:
            raise CalibrationError(
                f"{file}: the calibration has no intrinsics of the {side} camera; "
                "run rig calibrate-intrinsics first"
            )
        lenses.append(Undistorter(_intrinsics(lens, of_source), lens.distortion))
    return Pair(*lenses)


def _flattened(recording: Recorded, lenses: Pair[Undistorter]) -> Undistorted:
    straight = Pair(
        *(dataclasses.replace(lens.lens, distortion=(0.0, 0.0, 0.0, 0.0, 0.0)) for lens in lenses)
    )
    flat = dataclasses.replace(recording.header, intrinsics=straight)
    return Undistorted(recording, flat, lenses)


def _intrinsics(lens: LensCalibration, stated: Intrinsics) -> Intrinsics:
    whole = Intrinsics(
        lens.width_px, lens.height_px, lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px
    )
    return scaled(whole, stated.width_px, stated.height_px)


def _flat(shot: Frame | Lost, lens: Undistorter) -> Frame | Lost:
    if isinstance(shot, Lost):
        return shot
    grey = lens.apply(to_grey(shot.image, shot.pixel_format))
    return dataclasses.replace(shot, image=grey, pixel_format="mono8")
