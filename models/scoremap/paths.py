"""Path targets: the file that keeps drives with every setting tried at every pose.

Values of moves are worked out of the counts when training begins, so one file serves every
utility.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rig.bulk import Workers
from rig.core.errors import RecordingError, UsageError
from rig.models.scoremap.grid import SettingsGrid, path_grid
from rig.models.scoremap.seen import SeenDrive, see_drives
from rig.models.targets import require_new

SCHEMA = "rig.paths/4"


@dataclass(frozen=True, slots=True)
class DriveSource:
    """Where one drive came from, the pose that it begins with, and how many it has.

    `sha256` is of its pictures and counts.
    """

    name: str
    sha256: str
    cameras: str
    world_version: str
    first_pose: int
    poses: int


@dataclass(frozen=True, slots=True, eq=False)
class PathTargets:
    """Drives over one grid of settings."""

    grid: SettingsGrid
    drives: tuple[SeenDrive, ...]
    sources: tuple[DriveSource, ...]

    def save(self, path: Path) -> None:
        """Write an uncompressed npz without pickles; equal drives give equal bytes.

        Raises UsageError when the file exists.
        """
        require_new(path)
        arrays: dict[str, NDArray[np.generic]] = {}
        for index, drive in enumerate(self.drives):
            arrays[f"thumbnails_{index}"] = drive.thumbnails
            arrays[f"moves_{index}"] = drive.moves
            arrays[f"steady_{index}"] = drive.steady
            arrays[f"told_{index}"] = drive.told
        unfinished = path.with_name(path.name + ".part")
        with unfinished.open("wb") as file:
            np.savez(file, header=np.array(self._header()), **arrays)  # type: ignore[arg-type]
        unfinished.replace(path)

    @staticmethod
    def load(path: Path) -> PathTargets:
        """Read a file that `save` wrote; raises RecordingError when it is none."""
        if not path.exists():
            raise RecordingError(f"{path}: no such target file; make one with `rig targets`")
        try:
            return _load(path)
        except (ValueError, KeyError, TypeError, OSError, zipfile.BadZipFile) as error:
            raise RecordingError(
                f"{path}: not a file of path targets ({error}); make one with "
                "`rig targets sim:tunnel --seeds 1-12 --metric path`"
            ) from error

    def _header(self) -> str:
        return json.dumps(
            {
                "schema": SCHEMA,
                "exposures_us": self.grid.exposures_us,
                "gains_db": self.grid.gains_db,
                "drives": [
                    [drive.cameras, drive.world_version, drive.first_pose] for drive in self.drives
                ],
            }
        )


def make_paths(
    cameras: Sequence[str],
    *,
    first: int = 0,
    frames: int | None = None,
    processes: int | None = None,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> PathTargets:
    """Try every setting at every pose of simulated drives; pieces are kept in the user's cache.

    Each begins with pose `first` and has `frames` poses, all that are left when None. Raises
    UsageError for an address that is not simulated, is named twice, or a drive of fewer than two
    poses.
    """
    if not cameras:
        raise UsageError(
            "no cameras given: name at least one world, such as sim:tunnel --seeds 1-12"
        )
    if frames is not None and frames < 2:
        raise UsageError(f"--frames must be at least 2, got {frames}")
    if first < 0:
        raise UsageError(f"--first must be at least 0, got {first}")
    grid = path_grid()
    workers = Workers(processes)
    seen = see_drives(cameras, grid, first=first, frames=frames, workers=workers, progress=progress)
    return PathTargets(grid, tuple(seen), tuple(map(_source, seen)))


def _source(drive: SeenDrive) -> DriveSource:
    digest = hashlib.sha256(np.ascontiguousarray(drive.thumbnails).data)
    digest.update(np.ascontiguousarray(drive.moves).data)
    digest.update(np.ascontiguousarray(drive.steady).data)
    digest.update(np.ascontiguousarray(drive.told).data)
    stretch = f"@{drive.first_pose}" if drive.first_pose else ""
    return DriveSource(
        name=drive.cameras.removeprefix("sim:") + stretch,
        sha256=digest.hexdigest(),
        cameras=drive.cameras,
        world_version=drive.world_version,
        first_pose=drive.first_pose,
        poses=len(drive.thumbnails),
    )


def _load(path: Path) -> PathTargets:
    with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        if header.get("schema") != SCHEMA:
            raise ValueError(f"its schema is {header.get('schema')!r}, not {SCHEMA!r}")
        drives = tuple(
            SeenDrive(
                cameras,
                version,
                first,
                *(file[f"{part}_{index}"] for part in ("thumbnails", "moves", "steady", "told")),
            )
            for index, (cameras, version, first) in enumerate(header["drives"])
        )
    grid = SettingsGrid(tuple(header["exposures_us"]), tuple(header["gains_db"]))
    if any(drive.thumbnails.shape[1] != len(grid) for drive in drives):
        raise ValueError("its drives do not fit its grid")
    return PathTargets(grid, drives, tuple(map(_source, drives)))
