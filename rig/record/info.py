"""What a person asks of a recording first."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from itertools import groupby
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from rig.core.types import SIDES, Frame, Intrinsics, Pair, Settings, Side
from rig.core.units import NS_PER_S
from rig.record import topics
from rig.record.container import damage
from rig.record.frames import Frames
from rig.record.header import RECOVERY
from rig.record.reader import Recording
from rig.record.totals import Totals

Range = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """One camera's part in a run; ranges are (lowest, median, highest) used, None without frames.

    `settings_not_taken` counts the frames that were exposed with other settings than applied.
    """

    serial: str
    controller: str
    width_px: int
    height_px: int
    pixel_format: str
    frames: int
    exposure_us: Range | None
    gain_db: Range | None
    settings_not_taken: int


@dataclass(frozen=True, slots=True)
class Loss:
    """Triggers one after the other that are lost to the same cause.

    The time is that of the run, from the last that is known before them to the next one behind.
    """

    cause: str
    first_trigger: int
    last_trigger: int
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Info:
    """A recording at a glance; `recovered` tells that its end was lost."""

    file: str
    size_mb: float
    command: str
    cameras: str
    world_version: str
    seed: int
    git: str
    versions: Mapping[str, str]
    models: Mapping[str, str]
    duration_s: float
    rate_hz: float
    triggers: int
    pairs_complete: int
    drops: Mapping[str, int]
    losses: tuple[Loss, ...]
    recovered: bool
    primary: CameraInfo
    secondary: CameraInfo

    def as_dict(self) -> dict[str, Any]:
        """Return the same as plain dicts, lists and numbers."""
        return asdict(self)


def info(path: Path | str) -> Info:
    """Read the settings and causes of a recording, not its pictures, and say what is in it.

    Raises RecordingError when there is none, RecordingDamaged when it is cut short or its index
    is corrupt; whether all is as it was recorded tells `verify`.
    """
    with Frames(path) as frames, damage(frames.recording.path):
        return _info(frames)


def _info(frames: Frames) -> Info:
    recording = frames.recording
    header = recording.header
    totals, times_ns, pairs = Totals(), list[int](), list[_PairFact]()
    tallies = Pair(_CameraTally(), _CameraTally())
    for trigger in range(len(frames)):
        pair = frames.about(trigger, topics.PAIR)
        totals.add(pair["cause"])
        pairs.append(_PairFact(pair["sequence"], pair["cause"], _stamp_s(pair["header"])))
        metas = [frames.about(trigger, topics.frame_meta(side)) for side in SIDES]
        taken = [meta["status"] == "taken" for meta in metas]
        for tally, meta, came in zip(tallies, metas, taken, strict=True):
            if came:
                tally.add(meta)
        times_ns += [m["device_time_ns"] for m, came in zip(metas, taken, strict=True) if came][:1]
    for side, tally in zip(SIDES, tallies, strict=True):
        tally.pixel_format = _pixel_format(frames, side)
    primary, secondary = tallies
    duration_s = (times_ns[-1] - times_ns[0]) / NS_PER_S if times_ns else 0.0
    return Info(
        file=str(recording.path),
        size_mb=sum(part.stat().st_size for part in recording.parts) / 1e6,
        command=header.command,
        cameras=header.cameras,
        world_version=header.world_version,
        seed=header.seed,
        git=header.git,
        versions=dict(header.versions),
        models=dict(header.models),
        duration_s=duration_s,
        rate_hz=(len(times_ns) - 1) / duration_s if duration_s > 0 else 0.0,
        triggers=totals.triggers,
        pairs_complete=totals.complete,
        drops=totals.lost,
        losses=tuple(_losses(pairs)),
        recovered=RECOVERY in recording.metadata,
        primary=primary.info(recording, "primary"),
        secondary=secondary.info(recording, "secondary"),
    )


class _PairFact(NamedTuple):
    """What tells when a trigger was lost."""

    trigger: int
    cause: str
    time_s: float


def _stamp_s(header: Mapping[str, Any]) -> float:
    stamp = header["stamp"]
    return float(stamp["sec"] + stamp["nanosec"] / NS_PER_S)


def _losses(pairs: list[_PairFact]) -> Iterator[Loss]:
    """Yield each stretch of triggers that are lost to one cause."""
    for cause, group in groupby(enumerate(pairs), key=lambda each: each[1].cause):
        if not cause:
            continue
        members = list(group)
        (first, begun), (last, ended) = members[0], members[-1]
        before, behind = pairs[max(0, first - 1)], pairs[min(last + 1, len(pairs) - 1)]
        begin_s = pairs[0].time_s
        yield Loss(
            cause,
            begun.trigger,
            ended.trigger,
            before.time_s - begin_s,
            behind.time_s - begin_s,
        )


@dataclass(slots=True)
class _CameraTally:
    """Collects what one camera used."""

    used: list[Settings] = field(default_factory=list)
    not_taken: int = 0
    pixel_format: str = ""

    def add(self, meta: Mapping[str, Any]) -> None:
        used = Settings(**meta["used"])
        self.used.append(used)
        applied = meta["applied"]
        if applied["mode"] == "settings":
            self.not_taken += not _close(used, Settings(**applied["settings"]))

    def info(self, recording: Recording, side: Side) -> CameraInfo:
        intrinsics: Intrinsics = getattr(recording.header.intrinsics, side)
        return CameraInfo(
            serial=getattr(recording.header.serials, side),
            controller=getattr(recording.header.controllers, side),
            width_px=intrinsics.width_px,
            height_px=intrinsics.height_px,
            pixel_format=self.pixel_format,
            frames=len(self.used),
            exposure_us=_range([used.exposure_us for used in self.used]),
            gain_db=_range([used.gain_db for used in self.used]),
            settings_not_taken=self.not_taken,
        )


def _pixel_format(frames: Frames, side: Side) -> str:
    """Return the format of the first frame that came; empty without one."""
    for trigger in range(len(frames)):
        if frames.about(trigger, topics.frame_meta(side))["status"] == "taken":
            shot = frames.frame(trigger, side)
            return shot.pixel_format if isinstance(shot, Frame) else ""
    return ""


def _close(used: Settings, applied: Settings) -> bool:
    """Return whether two settings agree to the seven digits of a camera's 32-bit floats."""
    return math.isclose(used.exposure_us, applied.exposure_us, rel_tol=1e-6) and math.isclose(
        used.gain_db, applied.gain_db, rel_tol=1e-6, abs_tol=1e-6
    )


def _range(values: list[float]) -> Range | None:
    return (min(values), median(values), max(values)) if values else None
