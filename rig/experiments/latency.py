"""After how many frames a setting has effect: steps it, and looks when frames use it.

A frame's own word (its chunk data) decides; its brightness is the witness. 0 is the next frame.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice

from rig.core.errors import CameraError
from rig.core.protocols import Source
from rig.core.types import Frame, Pair, Settings
from rig.pair import CameraPair, both_frames

MOST_FRAMES = 12
"""A step that had no effect after so many frames has none."""

STEP = 4.0
"""How much longer or shorter the exposure becomes; far more than a scene changes in a frame."""

_SHORT_US = 500.0
_DARKEST_DN, _BRIGHTEST_DN = 12.0, 45.0
_MOST_LOST = 20


@dataclass(slots=True)
class CameraLatency:
    """Frames to effect of one camera, counted.

    `disputed` steps were told to have effect at one frame and were seen at another.
    """

    serial: str
    frames: Counter[int] = field(default_factory=Counter)
    without_effect: int = 0
    disputed: int = 0


def measure(source: Source, steps: int) -> Iterator[Pair[CameraLatency]]:
    """Step both cameras between two exposures; yield what is known after every step.

    Raises CameraError when pairs keep getting lost.
    """
    pair = CameraPair(source)
    found = Pair(*(CameraLatency(camera.serial) for camera in source.cameras))
    short_us = _dark_enough(pair)
    before = _settle(pair, short_us)
    for step in range(steps):
        target_us = short_us * STEP if step % 2 == 0 else short_us
        frames = _after(pair, target_us)
        for side, latency in enumerate(found):
            _count(latency, before[side], [each[side] for each in frames], target_us)
        before = frames[-1]
        yield found


def _dark_enough(pair: CameraPair) -> float:
    """Return an exposure at which the step's bright end is not clipped, nor its dark end black."""
    limits = pair.limits
    low_us = max(each.exposure_us[0] for each in limits)
    high_us = min(each.exposure_us[1] for each in limits) / STEP
    exposure_us = _SHORT_US
    for _ in range(6):
        means = [float(frame.image.mean()) for frame in _settle(pair, exposure_us)]
        if max(means) > _BRIGHTEST_DN:
            exposure_us *= _BRIGHTEST_DN / 2 / max(means)
        elif min(means) < _DARKEST_DN:
            exposure_us *= 2 * _DARKEST_DN / max(min(means), 0.5)
        else:
            break
        exposure_us = min(max(exposure_us, low_us), high_us)
    return exposure_us


def _settle(pair: CameraPair, exposure_us: float) -> Pair[Frame]:
    """Hold an exposure until it must have come; return the last pair."""
    return _after(pair, exposure_us)[-1]


def _after(pair: CameraPair, exposure_us: float) -> list[Pair[Frame]]:
    """Ask for an exposure once and return the frames that follow, two with it at the end."""
    settings = Settings(round(exposure_us), 0.0)
    pair.apply(Pair(settings, settings))
    frames: list[Pair[Frame]] = []
    for shot in islice(_whole(pair), MOST_FRAMES):
        frames.append(shot)
        if len(frames) > 1 and all(_near(f, exposure_us) for two in frames[-2:] for f in two):
            break
    return frames


def _whole(pair: CameraPair) -> Iterator[Pair[Frame]]:
    lost = 0
    while True:
        shot = pair.shoot()
        frames = both_frames(shot)
        if frames is not None:
            yield frames
            continue
        lost += 1
        if lost > _MOST_LOST:
            raise CameraError(f"{lost} pairs were lost while measuring, the last by: {shot.cause}")


def _count(latency: CameraLatency, before: Frame, frames: list[Frame], target_us: float) -> None:
    told = next((k for k, frame in enumerate(frames) if _near(frame, target_us)), None)
    if told is None:
        latency.without_effect += 1
        return
    latency.frames[told] += 1
    latency.disputed += told != _seen(before, frames)


def _near(frame: Frame, exposure_us: float) -> bool:
    return abs(frame.used.exposure_us - exposure_us) <= 0.1 * exposure_us


def _seen(before: Frame, frames: list[Frame]) -> int:
    """Return the first frame whose brightness is nearer to the last one's than to the old."""
    old, *means = (float(frame.image.mean()) for frame in (before, *frames))
    return next(k for k, mean in enumerate(means) if abs(mean - means[-1]) <= abs(mean - old))
