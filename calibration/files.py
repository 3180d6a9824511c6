"""calibration.toml: written, joined with what was known before, and checked against cameras."""

from __future__ import annotations

import datetime
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import msgspec

from rig.calibration.intrinsics import CameraFit, RigFit
from rig.config import Calibration, LensCalibration, StereoCalibration
from rig.core.errors import CalibrationError
from rig.core.types import SIDES, Intrinsics, Pair

SCHEMA: Final = "rig.calibration/1"
OLD_DAYS = 180
"""After this many days screws and rings have had time to move: a warning, not an error."""

PARTS: Final = ("primary", "secondary", "stereo", "aperture")
"""What a calibration can hold."""

_FOCAL_SHARE = 0.15


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration as TOML; an existing file is replaced."""
    values = msgspec.to_builtins(calibration, builtin_types=(datetime.date,))
    path.write_text(to_toml(values), encoding="utf-8")


def to_toml(values: Mapping[str, Any]) -> str:
    """Return a table of plain values and tables as TOML; None is left out."""
    lines = [f"{name} = {_word(value)}" for name, value in values.items() if _plain(value)]
    for name, value in values.items():
        if isinstance(value, Mapping):
            lines += ["", f"[{name}]", to_toml(value).rstrip()]
    return "\n".join(lines) + "\n"


def _plain(value: object) -> bool:
    return value is not None and not isinstance(value, Mapping)


def _word(value: object) -> str:
    if isinstance(value, datetime.date):
        return value.isoformat()
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_word, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def joined(new: Calibration, old: Calibration | None) -> Calibration:
    """Return `new` with those parts of `old` that it lacks.

    Raises CalibrationError when `old` is of other cameras or of another lens.
    """
    if old is None:
        return new
    check_serials(old, Pair(new.primary_serial, new.secondary_serial), "the earlier calibration")
    if new.lens and old.lens and new.lens != old.lens:
        raise CalibrationError(
            f"the earlier calibration is of lens {old.lens!r}, not {new.lens!r}; "
            "start a new file: name none with --calibration"
        )
    kept = {part: getattr(old, part) for part in PARTS if getattr(new, part) is None}
    return msgspec.structs.replace(new, lens=new.lens or old.lens, **kept)


def check_serials(calibration: Calibration, serials: Pair[str], file: str) -> None:
    """Raise CalibrationError unless the calibration is of these cameras, in this order."""
    of = Pair(calibration.primary_serial, calibration.secondary_serial)
    if of == serials:
        return
    if of == Pair(serials.secondary, serials.primary):
        raise CalibrationError(
            f"{file}: swapped cameras: it has {of.primary} as primary and {of.secondary} as "
            "secondary; exchange the serials in --cameras"
        )
    raise CalibrationError(
        f"{file}: is of cameras {of.primary} and {of.secondary}, these are {serials.primary} and "
        f"{serials.secondary}; calibrate them or name their file"
    )


def check_calibration(
    calibration: Calibration,
    serials: Pair[str],
    intrinsics: Pair[Intrinsics],
    today: datetime.date,
    file: str,
) -> list[str]:
    """Return warnings about a calibration's age; raises CalibrationError when it cannot be meant.

    The serials must be the cameras', and the focal lengths, brought to the picture size in use,
    within 15 % of the `intrinsics` that the cameras' source states: else it is another lens.
    """
    check_serials(calibration, serials, file)
    for side, stated in zip(SIDES, intrinsics, strict=True):
        lens: LensCalibration | None = getattr(calibration, side)
        if lens is not None:
            _check_lens(lens, stated, f"{file}: {side}")
    age_days = (today - calibration.date).days
    if age_days < 0:
        raise CalibrationError(
            f"{file}: is dated {calibration.date}, after the pictures of {today}; "
            "set the computer's clock or calibrate again"
        )
    if age_days > OLD_DAYS:
        return [f"{file}: is {age_days} days old ({calibration.date}); calibrate again"]
    return []


def _check_lens(lens: LensCalibration, stated: Intrinsics, where: str) -> None:
    if abs(lens.width_px * stated.height_px - lens.height_px * stated.width_px) > lens.width_px:
        raise CalibrationError(
            f"{where}: calibrated at {lens.width_px}x{lens.height_px}, the pictures are "
            f"{stated.width_px}x{stated.height_px}, another shape; calibrate at this one"
        )
    focal_px = lens.fx_px * stated.width_px / lens.width_px
    if abs(focal_px / stated.fx_px - 1) > _FOCAL_SHARE:
        raise CalibrationError(
            f"{where}: focal length {focal_px:.0f} px, these cameras have about "
            f"{stated.fx_px:.0f} px: calibrated with another lens; calibrate again"
        )


def today() -> datetime.date:
    """Return the day, in UTC, that a calibration made now carries."""
    return datetime.datetime.now(datetime.UTC).date()


def of_fit(fit: RigFit, serials: Pair[str], lens: str, today: datetime.date) -> Calibration:
    """Return the calibration that a fit comes to."""
    return Calibration(
        schema=SCHEMA,
        date=today,
        primary_serial=serials.primary,
        secondary_serial=serials.secondary,
        lens=lens,
        primary=_lens(fit.cameras.primary, fit.size_px),
        secondary=_lens(fit.cameras.secondary, fit.size_px),
        stereo=StereoCalibration(
            rotation=tuple(fit.stereo.rotation.ravel().tolist()),
            translation_m=tuple(fit.stereo.translation_m.tolist()),
            baseline_m=fit.stereo.baseline_m,
            baseline_sigma_m=fit.stereo.baseline_sigma_m,
            residual_px=fit.stereo.residual_px,
        ),
    )


def _lens(camera: CameraFit, size_px: tuple[int, int]) -> LensCalibration:
    k = camera.matrix
    return LensCalibration(
        width_px=size_px[0],
        height_px=size_px[1],
        fx_px=float(k[0, 0]),
        fy_px=float(k[1, 1]),
        cx_px=float(k[0, 2]),
        cy_px=float(k[1, 2]),
        distortion=tuple(camera.distortion.tolist()),
        residual_px=camera.residual_px,
    )
