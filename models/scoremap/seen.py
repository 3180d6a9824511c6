"""A simulated drive with every setting of a grid tried at every pose.

Only a simulation can do this. A drive is worked out in pieces that are kept in the user's cache,
so an interrupted run goes on where it was.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig.bulk import Workers, run_all
from rig.config import camera_digest
from rig.core.errors import UsageError
from rig.core.types import Intrinsics, PixelFormat, Settings, Truth
from rig.core.units import US_PER_S
from rig.drivers.addresses import parse_address
from rig.drivers.registry import open_source
from rig.drivers.scenes.cache import Arrays, cached
from rig.drivers.scenes.scene import Scene
from rig.drivers.scenes.trajectories import Pose
from rig.drivers.sensor.sensor import Sensor
from rig.drivers.simulated.source import SimulatedSource
from rig.models.scoremap.grid import SettingsGrid
from rig.models.scoremap.tracking import FeatureSets, count_moves, feature_sets, flow
from rig.vision.bayer import to_grey
from rig.vision.orb import OrbFeatures, OrbFrontEnd
from rig.vision.thumbnail import thumbnail
from rig.vision.viso2.front_end import Viso2Features, Viso2FrontEnd
from rig.vision.viso2.motion import Mount

RECIPE = "5"
"""Counts the ways in which drives were measured; what another way left in the cache is not used."""

LARGEST_MOVE_EV = 3.2
"""Moves that change the brightness by more are taken to match nothing."""

HOPELESS_SATURATED = 0.97
"""A picture with more saturated pixels than this has no features worth looking for."""

SHARP_US = 210.0
"""A shorter exposure is not blurred: it smears one point in a hundred by a fifth of a pixel."""

MOVES_M = 0.02
"""A vehicle that moves by less from picture to picture stands."""

FEW_FEATURES = 20
"""Where ORB finds fewer in a picture, the other front end is not asked: it would match nothing."""

_POSES_A_PIECE = 40
_NO_FEATURES = OrbFeatures(np.empty((0, 2), np.float32), np.empty((0, 32), np.uint8))

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class SeenDrive:
    """P poses of one drive, from `first_pose` on, under S settings.

    `thumbnails` is uint8 P x S x 2 x 48 x 64; `moves` int16 P-1 x S x S counts the ORB matches of
    the picture at a pose (first setting) with that at the next pose (second setting); `steady`
    int16 P-1 x S the viso2-style inliers of both pictures with the same setting, and `told` bool
    P-1 x S says whether visual odometry tells a motion from those two; where the vehicle moves by
    less than `MOVES_M` there is nothing to tell, and all of them count as told.
    """

    cameras: str
    world_version: str
    first_pose: int
    thumbnails: NDArray[np.uint8]
    moves: NDArray[np.int16]
    steady: NDArray[np.int16]
    told: NDArray[np.bool_]


def see_drives(
    cameras: Sequence[str],
    grid: SettingsGrid,
    *,
    first: int,
    frames: int | None,
    workers: Workers,
    progress: Progress,
) -> list[SeenDrive]:
    """Return the drives of simulated cameras, in their order; worlds are of the train split.

    Raises UsageError for an address that is not simulated, names a world twice, or whose drive has
    fewer than two poses from `first` on.
    """
    addresses = [_resolved(address) for address in cameras]
    _require_apart(addresses)
    pieces = [
        (address, start, min(start + _POSES_A_PIECE, last))
        for address, length in run_all(_length, addresses, workers)
        for last in [_last_pose(address, length, first, frames)]
        for start in range(first, last, _POSES_A_PIECE)
    ]
    seen: dict[tuple[str, int, int], Arrays] = {}
    progress(0, len(pieces))
    for piece, arrays in run_all(partial(_piece, grid), pieces, workers):
        seen[piece] = arrays
        progress(len(seen), len(pieces))
    return [
        _joined(address, first, [seen[piece] for piece in pieces if piece[0] == address])
        for address in addresses
    ]


def _require_apart(addresses: Sequence[str]) -> None:
    meant = [_meant(address) for address in addresses]
    for address, drive in zip(addresses, meant, strict=True):
        if meant.count(drive) > 1:
            raise UsageError(f"{address} is named twice")


def _meant(address: str) -> tuple[str, frozenset[tuple[str, str]]]:
    """Return what two spellings of one drive share."""
    parsed = parse_address(address)
    return parsed.name, frozenset({"split": "train", "seed": "0", **parsed.options}.items())


def _last_pose(address: str, length: int, first: int, frames: int | None) -> int:
    if first + 2 > length:
        raise UsageError(f"{address} has {length} poses: --first {first} leaves fewer than two")
    return (length if frames is None else min(first + frames, length)) - 1


def _joined(address: str, first: int, parts: list[Arrays]) -> SeenDrive:
    """Join the pieces; each has one pose more than moves, which the next one repeats."""
    thumbnails = [part["thumbnails"][:-1] for part in parts] + [parts[-1]["thumbnails"][-1:]]
    return SeenDrive(
        cameras=address,
        world_version=str(parts[0]["world_version"]),
        first_pose=first,
        thumbnails=np.concatenate(thumbnails).astype(np.uint8),
        moves=np.concatenate([part["moves"] for part in parts]).astype(np.int16),
        steady=np.concatenate([part["steady"] for part in parts]).astype(np.int16),
        told=np.concatenate([part["told"] for part in parts]).astype(np.bool_),
    )


def _resolved(cameras: str) -> str:
    """Return an address with every option named, without opening its world."""
    parsed = parse_address(cameras)
    if parsed.scheme != "sim":
        raise UsageError(
            f"{cameras}: only simulated cameras can see a pose under every setting; "
            "name worlds such as 'sim:tunnel?seed=7'"
        )
    return str(parsed)


def _length(address: str) -> tuple[str, int]:
    return address, _open(address).source.drive_triggers


@dataclass(frozen=True, slots=True, eq=False)
class _Opened:
    source: SimulatedSource
    scene: Scene
    sensor: Sensor

    @property
    def pixel_format(self) -> PixelFormat:
        return self.source.drive.model.picture.format


@lru_cache(maxsize=1)
def _open(address: str) -> _Opened:
    """Return the cameras of an address; the last ones stay open, one piece follows another."""
    source = open_source(address, seed=0, split="train")
    if not isinstance(source, SimulatedSource):
        raise UsageError(f"{address}: only simulated cameras know depth and poses")
    lens = source.scene.intrinsics("primary")
    sensor = Sensor(source.drive.model, (lens.height_px, lens.width_px), seed=0)
    return _Opened(source, source.scene, sensor)


def _piece(grid: SettingsGrid, piece: tuple[str, int, int]) -> tuple[tuple[str, int, int], Arrays]:
    """Return a piece with its poses `first` to `last`, both included, from the cache or seen."""
    address, first, last = piece
    opened = _open(address)
    camera = parse_address(opened.source.address).options["camera"]
    shown = opened.source.address + camera_digest(camera)
    words = (shown, opened.source.world_version, grid, first, last, RECIPE)
    return piece, cached("seen", repr(words), lambda: _see(opened, grid, first, last))


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """One pose under every setting; no viso2-style features where ORB found hardly any."""

    thumbnails: NDArray[np.uint8]
    orb: FeatureSets
    viso2: Sequence[Viso2Features | None]


def _see(opened: _Opened, grid: SettingsGrid, first: int, last: int) -> Arrays:
    looks = (_look(opened, grid, pose) for pose in range(first, last + 1))
    before = next(looks)
    thumbnails, moves, stays = [before.thumbnails], [], []
    allowed = grid.distance_ev(grid.cells()) <= LARGEST_MOVE_EV
    for pose, after in enumerate(looks, first):
        thumbnails.append(after.thumbnails)
        moves.append(_count(opened, before.orb, after.orb, pose, allowed))
        stays.append(_stay(opened.scene.intrinsics("primary"), before.viso2, after.viso2))
        before = after
    told = np.array([[told for _, told in cells] for cells in stays], np.bool_)
    stood = [_moved_m(opened, pose) < MOVES_M for pose in range(first, last)]
    return {
        "thumbnails": np.stack(thumbnails),
        "moves": np.stack(moves),
        "steady": np.array([[inliers for inliers, _ in cells] for cells in stays], np.int16),
        "told": told | np.array(stood)[:, None],
        "world_version": np.array(opened.source.world_version),
    }


def _count(
    opened: _Opened,
    before: FeatureSets,
    after: FeatureSets,
    pose: int,
    allowed: NDArray[np.bool_],
) -> NDArray[np.int16]:
    scene, drive = opened.scene, opened.source.drive
    times_s = [drive.scene_time_s(at) for at in (pose, pose + 1)]
    here, there = (_pose(scene.truth(time_s)) for time_s in times_s)
    depth_m = scene.view("primary", times_s[0]).depth_m
    predicted = flow(before.points_px, depth_m, scene.intrinsics("primary"), here, there)
    interval_us = (times_s[1] - times_s[0]) * US_PER_S
    return count_moves(before, after, predicted, interval_us, allowed)


def _stay(
    lens: Intrinsics, before: Sequence[Viso2Features | None], after: Sequence[Viso2Features | None]
) -> list[tuple[int, bool]]:
    """Return the inliers of each setting where it stays, and whether they tell a motion.

    The length of a motion does not matter here, so any height over the ground will do.
    """
    front_end = Viso2FrontEnd()
    stays = []
    for a, b in zip(before, after, strict=True):
        if a is None or b is None:
            stays.append((0, False))
            continue
        points = front_end.matched(a, b)
        motion = front_end.motion(front_end.bucket(points), lens, Mount())
        stays.append((front_end.judged(points).inliers, not motion.failure))
    return stays


def _moved_m(opened: _Opened, pose: int) -> float:
    """Return how far the camera comes from a pose to the next."""
    times_s = (opened.source.drive.scene_time_s(at) for at in (pose, pose + 1))
    here, there = (np.array(opened.scene.truth(time_s).position_m) for time_s in times_s)
    return float(np.linalg.norm(there - here))


def _pose(truth: Truth) -> Pose:
    """Return the primary camera's pose; the rotation is from the world to the optical frame."""
    rotation = Rotation.from_quat(truth.orientation_xyzw).as_matrix().T
    return Pose(rotation, np.array(truth.position_m))


def _look(opened: _Opened, grid: SettingsGrid, pose: int) -> _Look:
    """Look at a pose with every setting; hopeless pictures are not searched for features."""
    view = opened.scene.view("primary", opened.source.drive.scene_time_s(pose))
    small: list[NDArray[np.uint8]] = []
    found: list[tuple[OrbFeatures, Viso2Features | None]] = []
    for index, exposure_us in enumerate(grid.exposures_us):
        darkest = Settings(exposure_us, grid.gains_db[0])
        sharp = opened.sensor.develop(view.radiance_cd_m2, darkest, pose)
        hopeless = np.mean(sharp >= 250) > HOPELESS_SATURATED
        unblurred = hopeless or exposure_us < SHARP_US
        radiance = view.radiance_cd_m2 if unblurred else view.exposed(exposure_us)
        for number, gain_db in enumerate(grid.gains_db):
            noise_seed = (pose * len(grid) + index * len(grid.gains_db) + number) * 2 + 1
            picture = opened.sensor.develop(radiance, Settings(exposure_us, gain_db), noise_seed)
            small.append(thumbnail(picture, opened.pixel_format))
            hopeless = hopeless or small[-1][1].mean() > HOPELESS_SATURATED * 255
            grey = to_grey(picture, opened.pixel_format)
            found.append((_NO_FEATURES, None) if hopeless else _searched(grey))
    orb, viso2 = zip(*found, strict=True)
    return _Look(np.stack(small), feature_sets(orb, grid.cells()[:, 0].tolist()), viso2)


def _searched(grey: NDArray[np.uint8]) -> tuple[OrbFeatures, Viso2Features | None]:
    orb = OrbFrontEnd().features(grey)
    return orb, Viso2FrontEnd().features(grey) if len(orb) >= FEW_FEATURES else None
