"""Watches a run over the recorder's shoulder: the loop itself does not know of it."""

from __future__ import annotations

import shutil
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from rig.core.protocols import Recorder
from rig.core.types import Auto, Command, Frame, Lost, Pair, PairRecord
from rig.vision.bayer import to_grey
from rig.vision.orb import OrbFrontEnd
from rig.web.slot import Glimpse, Slot

_GB = 1e9
_MOST_CAUSES = 5


@dataclass(slots=True, eq=False)
class WatchedRecorder:
    """A `Recorder` that passes every record on, and leaves the newest two in a slot.

    Inliers need the picture before, so a glimpse holds both. Everything that costs time is done
    by whoever looks at the glimpse.
    """

    recorder: Recorder
    slot: Slot
    title: str
    folder: Path
    triggers: int | None
    _last: PairRecord | None = None
    _complete: int = 0
    _lost: Counter[str] = field(default_factory=Counter)

    def write(self, record: PairRecord) -> None:
        """Queue one record and show it."""
        self.recorder.write(record)
        if record.complete:
            self._complete += 1
        else:
            self._lost[record.cause] += 1
        last, self._last = self._last, record
        told = Told(self.title, self.folder, self.triggers, self._complete, dict(self._lost))
        self.slot.put(Glimpse(_frames(record), partial(describe, told, last, record)))

    def __enter__(self) -> Self:
        """Open the recorder."""
        self.recorder.__enter__()
        return self

    def __exit__(self, *exc: object) -> None:
        """Close the recorder."""
        self.recorder.__exit__(*exc)


@dataclass(frozen=True, slots=True)
class Told:
    """What a run says of itself beside its pictures."""

    title: str
    folder: Path
    triggers: int | None
    complete: int
    lost: dict[str, int]


def warm_up() -> None:
    """Match two small pictures, so that compiled code is loaded before the first trigger."""
    rng = np.random.default_rng(0)
    front_end = OrbFrontEnd(size_px=None)
    noise = rng.integers(0, 255, (240, 320)).astype(np.uint8)
    features = front_end.features(noise)
    front_end.match(features, features)


def describe(told: Told, last: PairRecord | None, record: PairRecord) -> dict[str, Any]:
    """Return the state of a run for the page."""
    frames, total = _frames(record), told.triggers or "endless"
    lost = sum(told.lost.values())
    free_gb = shutil.disk_usage(told.folder).free / _GB
    names = Pair(*("" if d is None else d.controller for d in record.decisions))
    causes = Counter(told.lost).most_common(_MOST_CAUSES)
    return {
        "title": told.title,
        "status": f"pair {record.trigger + 1} of {total}",
        "values": [
            ["controller", *names],
            ["exposure", *(_exposure(frame) for frame in frames)],
            ["gain", *(_gain(frame) for frame in frames)],
            ["asked next", *("" if d is None else _asked(d.command) for d in record.decisions)],
            ["mean", *(_mean(frame) for frame in frames)],
            ["ORB inliers", *_inliers(last, record)],
        ],
        "notes": [
            f"{told.complete} pairs complete, {lost} dropped",
            *(f"dropped {count}: {cause}" for cause, count in causes),
            f"disk: {free_gb:.1f} GB left",
        ],
    }


def _inliers(last: PairRecord | None, record: PairRecord) -> Pair[str]:
    """Return the ORB inliers with the picture before, as the evaluation counts them."""
    if last is None or not (last.complete and record.complete):
        return Pair("", "")
    front_end = OrbFrontEnd()
    counts = []
    for before, now in zip(_frames(last), _frames(record), strict=True):
        if before is None or now is None:
            return Pair("", "")
        a, b = (front_end.features(to_grey(f.image, f.pixel_format)) for f in (before, now))
        counts.append(str(int(np.count_nonzero(front_end.match(a, b).inlier_mask))))
    return Pair(*counts)


def _frames(record: PairRecord) -> Pair[Frame | None]:
    return Pair(*(None if isinstance(shot, Lost) else shot for shot in record.shot))


def _exposure(frame: Frame | None) -> str:
    return "" if frame is None else f"{frame.used.exposure_us:.0f} us"


def _gain(frame: Frame | None) -> str:
    return "" if frame is None else f"{frame.used.gain_db:.1f} dB"


def _mean(frame: Frame | None) -> str:
    return "" if frame is None else f"{frame.image[::8, ::8].mean():.0f}"


def _asked(command: Command) -> str:
    if isinstance(command, Auto):
        return "camera's own"
    return f"{command.exposure_us:.0f} us, {command.gain_db:.1f} dB"
