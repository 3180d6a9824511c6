"""The calibration of a recording: attached when it is made, checked when it is read."""

from __future__ import annotations

import datetime
from pathlib import Path

from rig.calibration.files import check_calibration, today
from rig.calibration.undistorted import attached_calibration
from rig.cli.terminal import Terminal
from rig.config import Calibration, load_calibration
from rig.core.errors import CalibrationError, ConfigError
from rig.core.protocols import Source
from rig.core.types import Pair
from rig.record.reader import Recording

USUAL = Path("calibration.toml")


def calibration_for(source: Source, named: Path | None, terminal: Terminal) -> str:
    """Return the text of the calibration to attach; empty when there is none.

    A file that was named must be of these cameras: raises CalibrationError. The calibration.toml
    of the current folder is attached when it is of these cameras, else it is told why not.
    """
    if named is not None:
        return _checked(source, named, terminal)
    if not USUAL.is_file():
        return ""
    try:
        return _checked(source, USUAL, terminal)
    except CalibrationError as error:
        terminal.say(f"not attached: {error}")
        return ""


def _checked(source: Source, path: Path, terminal: Terminal) -> str:
    calibration = load_calibration(path)
    serials = Pair(*(camera.serial for camera in source.cameras))
    for warning in check_calibration(calibration, serials, source.intrinsics, today(), str(path)):
        terminal.say(f"warning: {warning}")
    terminal.detail(f"calibration: {path} of {calibration.date}")
    return path.read_text(encoding="utf-8")


def check_attached(recording: Recording, terminal: Terminal) -> None:
    """Warn of a calibration in a recording that is old, or not of the cameras that recorded."""
    for warning in calibration_of(recording)[1]:
        terminal.say(f"warning: {warning}")


def calibration_of(recording: Recording) -> tuple[Calibration | None, list[str]]:
    """Return the calibration that a recording carries, None without one, and what is odd."""
    try:
        return attached_calibration(recording.header, str(recording.path), taken_on(recording))
    except (CalibrationError, ConfigError) as error:
        return None, [str(error)]


def taken_on(recording: Recording) -> datetime.date:
    """Return the day on which a recording was finished, in UTC: that of its file."""
    written_s = recording.path.stat().st_mtime
    return datetime.datetime.fromtimestamp(written_s, datetime.UTC).date()
