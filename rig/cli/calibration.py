"""What the three calibration commands share: options, cameras, and how a live one is watched."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cyclopts import Parameter

from rig.calibration.files import joined, write_calibration
from rig.cli.exits import FAILED, OK
from rig.cli.options import Triggers
from rig.cli.terminal import Terminal
from rig.config import Calibration, load_calibration

CALIBRATION = "calibration.toml"


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class CalibrationOptions:
    """Which cameras to calibrate, for how long, and where to write."""

    cameras: str | None = None
    """Address of the camera pair; a simulated one when absent."""
    frames: Triggers = None
    """At most this many triggers."""
    seed: int = 0
    """Seeds the simulated world and its noise."""
    out: Path | None = None
    """Folder to make; runs/<time>-<command> when absent."""


DEFAULT_CALIBRATION = CalibrationOptions()


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class KnownOptions:
    """What is already known of the cameras."""

    calibration: Path | None = None
    """An earlier calibration.toml of these cameras, to be completed."""
    lens: str = ""
    """Name of the lens, such as HF6XA-5M; kept in the file and compared later."""


DEFAULT_KNOWN = KnownOptions()


def earlier(known: KnownOptions) -> Calibration | None:
    """Return the calibration that is to be completed; raises ConfigError for a bad file.

    Call it before the cameras are opened: a guided calibration takes minutes.
    """
    return None if known.calibration is None else load_calibration(known.calibration)


def store(folder: Path, found: Calibration, before: Calibration | None) -> Path:
    """Write `found`, joined with what was known before, into `folder`; return the file."""
    path = folder / CALIBRATION
    write_calibration(path, joined(found, before))
    return path


def tell(
    terminal: Terminal,
    text: str,
    file: Path,
    residual: float,
    tolerance: float,
    passed: bool,
    named: Mapping[str, Any],
) -> int:
    """Print a calibration's result; return 0 when it is good enough, else 1."""
    verdict = "passed" if passed else "NOT GOOD ENOUGH"
    values = {
        "file": str(file),
        "residual": residual,
        "tolerance": tolerance,
        "passed": passed,
        **named,
    }
    terminal.result(f"{text}\n{verdict}: {file}", values)
    return OK if passed else FAILED
