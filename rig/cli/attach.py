"""The calibration that goes into a recording, checked against the cameras that are open."""

from __future__ import annotations

from pathlib import Path

from rig.calibration.files import check_calibration, today
from rig.cli.terminal import Terminal
from rig.config import load_calibration
from rig.core.errors import CalibrationError
from rig.core.protocols import Source
from rig.core.types import Pair

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
