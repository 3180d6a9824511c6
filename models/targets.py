"""Targets of recordings, and the file that keeps them beside the pictures they belong to."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from itertools import takewhile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rig.bulk import ALONE, Workers, run_tasks
from rig.core.errors import RecordingError, RigError, UsageError
from rig.core.types import PairRecord
from rig.models.measuring import Stretch, stretches
from rig.models.metrics import TargetMetric, Window, find_metric
from rig.models.spool import Spool
from rig.record.reader import Recording, open_recording

SCHEMA = "rig.targets/1"
_ZIP_NAME_LENGTH_AT = 26
_ZIP_HEADER_BYTES = 30

Progress = Callable[[str, int, int], None]
"""Told the recording's name, the triggers done and the triggers in all; from other processes, a
recording that is done, how many are, and how many there are."""


@dataclass(frozen=True, slots=True)
class RecordingSource:
    """Which recording poses came from: enough to know it again and to make it again."""

    name: str
    sha256: str
    triggers: int
    command: str
    cameras: str
    seed: int
    leader: str
    options: Mapping[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """P poses: the K pictures of each, their settings, and the settings to aim for.

    `images` is uint8 P x K x 3 x 224 x 224 (of a pair: primary then secondary; red, green, blue),
    the used settings are P x K, everything else is P long. `recording` counts the file's
    recordings; poses of equal `drive` follow each other without a loss.
    """

    images: NDArray[np.uint8]
    used_exposure_us: NDArray[np.float64]
    used_gain_db: NDArray[np.float64]
    target_exposure_us: NDArray[np.float64]
    target_gain_db: NDArray[np.float64]
    trigger: NDArray[np.int64]
    pose_index: NDArray[np.int64]
    recording: NDArray[np.int64]
    drive: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.trigger)


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """The poses of some recordings with targets, and how the targets were chosen."""

    metric: str
    window: int
    alpha: float
    recordings: tuple[RecordingSource, ...]
    poses: Poses

    def save(self, path: Path) -> None:
        """Write an uncompressed npz without pickles; equal targets give equal bytes.

        Raises UsageError when the file exists.
        """
        require_new(path)
        arrays = {field.name: getattr(self.poses, field.name) for field in fields(Poses)}
        unfinished = path.with_name(path.name + ".part")
        with unfinished.open("wb") as file:
            np.savez(file, header=np.array(self._header()), **arrays)
        unfinished.replace(path)

    @staticmethod
    def load(path: Path) -> Targets:
        """Read a file that `save` wrote; the pictures stay on disk until they are used.

        Raises RecordingError when it is no target file.
        """
        if not path.exists():
            raise RecordingError(f"{path}: no such target file; make one with `rig targets`")
        try:
            return _load(path)
        except (ValueError, KeyError, TypeError, OSError, zipfile.BadZipFile) as error:
            raise RecordingError(
                f"{path}: not a target file ({error}); make one with `rig targets`"
            ) from error

    def _header(self) -> str:
        return json.dumps(
            {
                "schema": SCHEMA,
                "metric": self.metric,
                "window": self.window,
                "alpha": self.alpha,
                "recordings": [asdict(source) for source in self.recordings],
            }
        )


def require_new(out: Path) -> None:
    """Make the folder of a file to be written; call it before the long work.

    Raises UsageError when `out` exists, for nothing is overwritten, RigError when nothing can be
    written there.
    """
    if out.exists():
        raise UsageError(f"{out} exists: choose another --out or delete it")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        if not os.access(out.parent, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise RigError(f"--out {out} cannot be written: {error.strerror}") from None


def make_targets(
    recordings: Sequence[Path],
    metric: str = "hybrid",
    window: int = 4,
    alpha: float = 0.5,
    progress: Progress | None = None,
    workers: Workers = ALONE,
    folder: Path | None = None,
) -> Targets:
    """Find the targets of every pose of the recordings that has a pose after it.

    A lost frame ends a drive and the next complete pair begins another: no window and no input
    reaches across. The pictures, 0.3 MB a pose of a pair, wait in a file in `folder`. Raises
    UsageError for an unknown metric or a bad window, RecordingError for a recording with nothing
    to learn from.
    """
    find_metric(metric), Window(window, alpha)
    if not recordings:
        raise UsageError("no recordings given: name at least one to make targets from")
    watch = progress if workers == ALONE else None
    work = partial(_found_in, metric, window, alpha, watch)
    tasks = {str(path): path for path in recordings}
    if len(tasks) < len(recordings):
        raise UsageError("a recording is named twice: its poses would count twice")
    kept: list[_Found] = []
    waiting: dict[str, _Found] = {}
    with closing(Spool(folder)) as spool:
        for done, (name, each) in enumerate(run_tasks(work, tasks, workers), start=1):
            waiting[name] = each
            for due in takewhile(waiting.__contains__, list(tasks)[len(kept) :]):
                kept.append(_spooled(waiting.pop(due), spool))
            if progress is not None and watch is None:
                progress(each.source.name, done, len(tasks))
        poses = _joined(kept, spool)
    return Targets(metric, window, alpha, tuple(each.source for each in kept), poses)


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """The poses of one recording, a `Poses` a drive, counted from 0."""

    source: RecordingSource
    drives: list[Poses]


def _found_in(
    metric: str, window: int, alpha: float, progress: Progress | None, path: Path
) -> _Found:
    """Find the targets of one recording; raises RecordingError when there are none."""
    chosen, reach = find_metric(metric), Window(window, alpha)
    recording = open_recording(path)
    source = _source(recording, path)
    records = _watched(recording.records(), source.name, len(recording), progress)
    drives = [
        _with_targets(stretch, chosen, reach, drive)
        for drive, stretch in enumerate(stretches(records, chosen, recording.header.intrinsics))
    ]
    if not drives:
        raise RecordingError(
            f"{path}: no two complete poses follow each other, so no pose has a target; "
            "`rig verify` tells what was lost"
        )
    return _Found(source, drives)


def _spooled(found: _Found, spool: Spool) -> _Found:
    """Put the pictures of a recording into the spool and keep one of each drive's poses."""
    for poses in found.drives:
        spool.append(poses.images)
    return replace(found, drives=[replace(p, images=p.images[:1].copy()) for p in found.drives])


def _joined(found: Sequence[_Found], spool: Spool) -> Poses:
    """Put the poses of all recordings behind each other, recordings and drives counted on.

    Their pictures are those of the spool. Raises UsageError when some have more pictures a pose
    than others.
    """
    counts = {each.source.name: each.drives[0].images.shape[1] for each in found}
    if len(set(counts.values())) > 1:
        fewest, most = min(counts, key=lambda n: counts[n]), max(counts, key=lambda n: counts[n])
        raise UsageError(
            f"{fewest} has {counts[fewest]} pictures a pose and {most} has {counts[most]}: make a "
            "target file of each kind, training takes several"
        )
    drives: list[Poses] = []
    for index, each in enumerate(found):
        before = len(drives)
        drives += [
            replace(
                poses,
                recording=np.full(len(poses), index, np.int64),
                drive=poses.drive + before,
            )
            for poses in each.drives
        ]
    names = [field.name for field in fields(Poses) if field.name != "images"]
    joined = {name: np.concatenate([getattr(drive, name) for drive in drives]) for name in names}
    return Poses(images=spool.pictures(*drives[0].images.shape[1:]), **joined)


def _source(recording: Recording, path: Path) -> RecordingSource:
    header = recording.header
    folder = path if path.is_dir() else path.parent
    return RecordingSource(
        name=folder.resolve().name,
        sha256=_sha256(folder),
        triggers=len(recording),
        command=header.command,
        cameras=header.cameras,
        seed=header.seed,
        leader=header.controllers.primary,
        options=dict(header.options),
    )


def _watched(
    records: Iterable[PairRecord], name: str, count: int, progress: Progress | None
) -> Iterator[PairRecord]:
    for done, record in enumerate(records, start=1):
        yield record
        if progress is not None:
            progress(name, done, count)


def _with_targets(stretch: Stretch, metric: TargetMetric, window: Window, drive: int) -> Poses:
    """Return all poses of a stretch but the last, which has nothing after it to aim for."""
    best = metric.choose(stretch.drive, window)
    n = len(best)
    return Poses(
        images=stretch.images[:n],
        used_exposure_us=stretch.drive.used[:n, :, 0],
        used_gain_db=stretch.drive.used[:n, :, 1],
        target_exposure_us=best[:, 0],
        target_gain_db=best[:, 1],
        trigger=stretch.trigger[:n],
        pose_index=stretch.pose_index[:n],
        recording=np.zeros(n, np.int64),
        drive=np.full(n, drive, np.int64),
    )


def _sha256(folder: Path) -> str:
    """Return the digest of a recording's MCAP files, in the order of their names."""
    digest = hashlib.sha256()
    for part in sorted(folder.glob("*.mcap")):
        with part.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def _load(path: Path) -> Targets:
    with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        small = {field.name: file[field.name] for field in fields(Poses) if field.name != "images"}
    if header.pop("schema", None) != SCHEMA:
        raise ValueError(f"its schema is not {SCHEMA}")
    sources = tuple(RecordingSource(**source) for source in header.pop("recordings"))
    poses = Poses(images=_mapped(path, "images.npy"), **small)
    return Targets(recordings=sources, poses=poses, **header)


def _mapped(path: Path, member: str) -> NDArray[np.uint8]:
    """Map an array that lies uncompressed inside an npz into memory, read-only."""
    with zipfile.ZipFile(path) as archive, archive.open(member) as file:
        np.lib.format.read_magic(file)
        shape, fortran_order, dtype = np.lib.format.read_array_header_1_0(file)
        array_header_bytes = file.tell()
        info = archive.getinfo(member)
    if info.compress_type != zipfile.ZIP_STORED or fortran_order or dtype != np.uint8:
        raise ValueError(f"{member} is not stored as plain uint8")
    with path.open("rb") as raw:
        raw.seek(info.header_offset + _ZIP_NAME_LENGTH_AT)
        name_bytes, extra_bytes = np.frombuffer(raw.read(4), "<u2")
    offset = info.header_offset + _ZIP_HEADER_BYTES + int(name_bytes) + int(extra_bytes)
    return np.memmap(path, np.uint8, "r", offset + array_header_bytes, shape)
