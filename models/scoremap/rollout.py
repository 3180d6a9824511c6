"""Driving through seen drives: controllers in closed loop without rendering anything anew.

A picture of settings between the cells of the grid is interpolated from its four neighbours, and
so is the number of matches of a move.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rig.core.types import THESIS_LIMITS, Limits
from rig.models.scoremap.grid import SettingsGrid, brightness_ev
from rig.models.scoremap.seen import SeenDrive
from rig.models.scoremap.values import kept_share

Settings2 = NDArray[np.float64]
"""N x (exposure_us, gain_db)."""

Frames = NDArray[np.uint8]
"""N x 2 x 48 x 64 thumbnails."""

Policy = Callable[[int, Frames, Settings2], Settings2]
"""Told the pose, the pictures of all cars and the settings they used; returns the next ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Trip:
    """What awaits one car: drive number `drive`, a slow camera, and another light.

    Settings take effect `latency` frames later than in the next frame. `light` is by how many
    steps of the grid (`SettingsGrid.relit`) each pose is brighter than it was seen; behind its end
    the light stays as it was.
    """

    drive: int
    latency: int = 0
    light: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64))

    def light_at(self, poses: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the steps of some poses."""
        return self.light[np.minimum(poses, len(self.light) - 1)]


@dataclass(frozen=True, slots=True, eq=False)
class Journey:
    """One car's trip: P pictures and the settings of each."""

    trip: Trip
    frames: Frames
    used: Settings2


def roll_out(
    drives: Sequence[SeenDrive],
    grid: SettingsGrid,
    trips: Sequence[Trip],
    start: Settings2,
    policy: Policy,
) -> list[Journey]:
    """Send one car on each trip, from `start[i]`; all move at once, pose by pose.

    A shorter drive ends sooner; its car stands at the end until the longest is over.
    """
    lengths = np.array([len(drives[trip.drive].thumbnails) for trip in trips])
    frames = [np.empty((n, *drives[0].thumbnails.shape[2:]), np.uint8) for n in lengths]
    used = [np.empty((n, 2)) for n in lengths]
    latency = np.array([trip.latency for trip in trips])
    asked = [np.array(start, np.float64)]
    for pose in range(int(lengths.max())):
        at = np.minimum(pose, lengths - 1)
        commands = np.stack(asked[-1 - int(latency.max()) :])
        sent = np.maximum(len(commands) - 1 - latency, 0)
        settings = commands[sent, np.arange(len(trips))]
        seen = look(drives, grid, trips, at, settings)
        for car, index in enumerate(at):
            if pose == index:
                frames[car][pose], used[car][pose] = seen[car], settings[car]
        asked.append(clamped(policy(pose, seen, settings)))
    return [Journey(*one) for one in zip(trips, frames, used, strict=True)]


def look(
    drives: Sequence[SeenDrive],
    grid: SettingsGrid,
    trips: Sequence[Trip],
    poses: NDArray[np.int64],
    settings: Settings2,
) -> Frames:
    """Return what each car sees at its pose with its settings."""
    cells, weights = grid.corners(settings)
    seen = np.empty((len(trips), *drives[0].thumbnails.shape[2:]), np.uint8)
    for car, (trip, pose) in enumerate(zip(trips, poses, strict=True)):
        like = grid.relit(int(trip.light_at(pose)))[cells[car]]
        corners = drives[trip.drive].thumbnails[pose, like].astype(np.float32)
        seen[car] = np.rint(np.tensordot(weights[car].astype(np.float32), corners, 1))
    return seen


def matches(
    drive: SeenDrive, grid: SettingsGrid, used: Settings2, trip: Trip
) -> NDArray[np.float64]:
    """Return the P-1 counts between consecutive pictures of a trip with these settings.

    Between cells a move is a mixture of moves between cells in which both ends shift together as
    far as they can: resting between two cells is a mixture of resting on either.
    """
    cells, weights = _relit_corners(grid, used, trip)
    between = drive.moves[
        np.arange(len(used) - 1)[:, None, None], cells[:-1, :, None], cells[1:, None, :]
    ]
    return np.asarray((between * _together(weights[:-1], weights[1:])).sum((1, 2)))


def other_inliers(
    drive: SeenDrive, grid: SettingsGrid, used: Settings2, trip: Trip
) -> NDArray[np.float64]:
    """Return the P-1 viso2-style inliers to expect between consecutive pictures of a trip."""
    kept = kept_share(np.diff(brightness_ev(used)))
    return np.asarray(_poorer(drive.steady, grid, used, trip) * kept)


def lost_motions(
    drive: SeenDrive, grid: SettingsGrid, used: Settings2, trip: Trip
) -> NDArray[np.float64]:
    """Return how likely, 0 to 1, each of the P-1 pairs of a trip tells visual odometry no motion.

    It is 0 where no setting would tell one: the vehicle stands.
    """
    lost = drive.told.any(1) - _poorer(drive.told, grid, used, trip)
    return np.asarray(np.clip(lost, 0.0, 1.0))


def _poorer(
    counts: NDArray[np.int16] | NDArray[np.bool_], grid: SettingsGrid, used: Settings2, trip: Trip
) -> NDArray[np.float64]:
    """Return the lesser of what both settings of each pair of a trip have where they stay."""
    cells, weights = _relit_corners(grid, used, trip)
    pair = np.arange(len(used) - 1)[:, None]
    before, after = (
        (counts[pair, cells[ends]] * weights[ends]).sum(1)
        for ends in (slice(None, -1), slice(1, None))
    )
    return np.asarray(np.minimum(before, after), np.float64)


def _relit_corners(
    grid: SettingsGrid, used: Settings2, trip: Trip
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    cells, weights = grid.corners(used)
    light = trip.light_at(np.arange(len(used)))
    relit = [grid.relit(int(steps))[one] for steps, one in zip(light, cells, strict=True)]
    return np.stack(relit), weights


def _together(before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return N x 4 x 4 weights with these sums, as much of each on the diagonal as can be."""
    both = np.minimum(before, after)
    apart = (before - both)[:, :, None] * (after - both)[:, None, :]
    left = np.maximum(1 - both.sum(1), np.finfo(float).tiny)[:, None, None]
    return np.asarray(apart / left + both[:, :, None] * np.eye(4))


def clamped(settings: Settings2, limits: Limits = THESIS_LIMITS) -> Settings2:
    """Return the nearest settings inside the limits."""
    exposures = np.clip(settings[:, 0], *limits.exposure_us)
    return np.stack([exposures, np.clip(settings[:, 1], *limits.gain_db)], axis=1)
