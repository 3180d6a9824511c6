"""Options that several commands share, and the folder that a run writes into."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated
from urllib.parse import parse_qs

from cyclopts import Parameter
from cyclopts.validators import Number

from rig.core.errors import RigError, UsageError

DEFAULT_CAMERAS = "sim:tunnel"

Triggers = Annotated[int | None, Parameter(validator=Number(gte=1))]
"""How many triggers to take, one at least; the parser refuses less."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class RunOptions:
    """Which cameras to drive, for how long, and where to."""

    cameras: str | None = None
    """Address of the camera pair, such as sim:tunnel?size=1024x768; sim:tunnel when absent."""
    frames: Triggers = None
    """Exactly this many triggers; the whole drive when absent."""
    seed: int = 0
    """Seeds the world, the noise and the controllers."""
    out: Path | None = None
    """Folder to make; runs/<time>-<command> when absent."""
    calibration: Path | None = None
    """Calibration to attach; calibration.toml of the current folder when absent."""


DEFAULT_RUN = RunOptions()


def chosen_cameras(named: str | None, usual: str = DEFAULT_CAMERAS) -> str:
    """Return the address to open: the one that was named, or the usual one.

    Raises RigError when none was named and real cameras are connected: nobody should take a
    simulation for them.
    """
    if named is not None:
        return named
    from rig.drivers.connected import connected_cameras

    found = connected_cameras()
    if found:
        serials = [camera.serial for camera in found]
        real = f"aravis:{','.join(serials[:2] if len(serials) > 1 else [*serials, 'SECONDARY'])}"
        raise RigError(
            f"real cameras are connected ({', '.join(serials)}) and --cameras was not given: "
            f"pass --cameras {real} for them, or --cameras {usual} for the simulation"
        )
    return usual


def names_a_world(cameras: str | None) -> bool:
    """Return whether an address says itself which world it is."""
    return "seed" in parse_qs((cameras or "").partition("?")[2])


def refuse_own_seed(cameras: str | None) -> None:
    """Raise UsageError for an address that names one world where --seeds names many."""
    if names_a_world(cameras):
        raise UsageError(
            f"--seeds and the seed in {cameras} exclude each other: every drive would be in that "
            "one world; leave one of them out"
        )


def is_simulated(address: str) -> bool:
    """Return whether an address names cameras that do not exist."""
    return address.startswith(("sim:", "gige:"))


def run_folder(out: Path | None, command: str) -> Path:
    """Return the folder that a run will make; raises RigError for one that is already there."""
    folder = out or _unused(Path("runs") / f"{datetime.now():%Y%m%d-%H%M%S}-{command}")
    if folder.exists():
        raise RigError(f"--out {folder} exists, nothing is overwritten: name a new one")
    return folder


def make_folder(folder: Path) -> None:
    """Make a new folder; raises RigError for one that is already there or cannot be."""
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise RigError(
            f"--out {folder} exists: nothing is overwritten; name a new folder"
        ) from None
    except OSError as error:
        raise RigError(f"--out {folder} cannot be made: {error.strerror}") from None


def _unused(folder: Path) -> Path:
    """Return `folder`, or a numbered neighbour where two runs began in one second."""
    names = [folder, *(folder.with_name(f"{folder.name}-{n}") for n in range(2, 100))]
    return next(name for name in names if not name.exists())
