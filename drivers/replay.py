"""The frames of a recording as a pair of cameras: `replay:FILE`.

They come as they were taken, whatever is asked for; their settings tell so. Losses come again as
losses, and time is that of the recording. Triggers are counted anew: a repaired recording may lack
some in between.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from rig.core.clock import VirtualClock
from rig.core.errors import CameraLost, GrabTimeout
from rig.core.protocols import Camera, Clock
from rig.core.types import (
    SIDES,
    Command,
    Frame,
    Intrinsics,
    Limits,
    Pair,
    PairRecord,
    Side,
    Truth,
)
from rig.record.reader import Recording, open_recording


def open_replay(path: Path) -> ReplaySource:
    """Open a recording as cameras; raises RecordingError when it cannot be read."""
    return ReplaySource(open_recording(path))


@dataclass(slots=True)
class _Player:
    """Steps through the records; both cameras look at the one that was triggered last."""

    recording: Recording
    clock: VirtualClock
    records: Iterator[PairRecord] = field(init=False)
    poses: list[int] = field(default_factory=list)
    truths: list[Truth | None] = field(default_factory=list)
    now: PairRecord | None = None

    def __post_init__(self) -> None:
        self.records = self.recording.records()

    @property
    def last(self) -> int:
        """Return the number of the last trigger."""
        return len(self.poses) - 1

    def step(self) -> None:
        """Go on to the next record; raises CameraLost behind the last."""
        self.now = next(self.records, None)
        if self.now is None:
            raise CameraLost(
                f"replay:{self.recording.path} ended after {len(self.recording)} triggers; "
                f"use --frames {len(self.recording)} or fewer"
            )
        self.poses.append(self.now.pose_index)
        self.truths.append(self.now.truth)
        times_ns = [shot.device_time_ns for shot in self.now.shot if isinstance(shot, Frame)]
        self.clock.advance_to_ns(max(times_ns, default=0))


@dataclass(slots=True)
class ReplayCamera:
    """One camera of a recording."""

    side: Side
    player: _Player

    @property
    def serial(self) -> str:
        """Return the serial number that was recorded."""
        serial: str = getattr(self.player.recording.header.serials, self.side)
        return serial

    @property
    def limits(self) -> Limits:
        """Return limits that allow what any controller asks for."""
        return Limits()

    def apply(self, command: Command) -> Command:
        """Take note of nothing: the picture was taken already."""
        return command

    def trigger(self) -> None:
        """Go on to the next pair; the secondary is triggered by the primary."""
        if self.side == "primary":
            self.player.step()

    def grab(self, timeout_s: float) -> Frame:
        """Return the frame of the last trigger; raises GrabTimeout when it was lost."""
        if self.player.now is None:
            raise GrabTimeout(f"camera {self.serial}: no trigger was fired", "no trigger")
        shot = getattr(self.player.now.shot, self.side)
        if isinstance(shot, Frame):
            return replace(shot, sequence=self.player.last)
        cause = shot.cause.removeprefix(f"{self.side}: ")
        raise GrabTimeout(f"camera {self.serial}: lost in the recording: {cause}", cause)

    def close(self) -> None:
        """Do nothing: the recording belongs to both cameras."""


class ReplaySource:
    """A recording as an opened pair of cameras."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._clock = VirtualClock()
        self._player = _Player(recording, self._clock)

    @property
    def address(self) -> str:
        """Return the address that was opened."""
        return f"replay:{self._recording.path}"

    @property
    def cameras(self) -> Pair[Camera]:
        """Return the two cameras."""
        return Pair(*(ReplayCamera(side, self._player) for side in SIDES))

    @property
    def intrinsics(self) -> Pair[Intrinsics]:
        """Return the recorded intrinsics."""
        return self._recording.header.intrinsics

    @property
    def clock(self) -> Clock:
        """Return the clock of the recorded device times."""
        return self._clock

    @property
    def real_time(self) -> bool:
        """Return False: a recording waits."""
        return False

    @property
    def rate_hz(self) -> float | None:
        """Return None: the recorded times set the pace."""
        return None

    @property
    def decision_ms(self) -> float:
        """Return 0: a decision moves no recorded time."""
        return 0.0

    @property
    def drive_triggers(self) -> int | None:
        """Return how many triggers were recorded."""
        return len(self._recording)

    @property
    def world_version(self) -> str:
        """Return the version of the world that was recorded; empty for real cameras."""
        return self._recording.header.world_version

    def pose_index(self, trigger: int) -> int:
        """Return the recorded pose of a trigger that was fired."""
        return self._player.poses[trigger]

    def truth(self, trigger: int) -> Truth | None:
        """Return the recorded truth of a trigger that was fired."""
        return self._player.truths[trigger]

    def close(self) -> None:
        """Do nothing: no file stays open between triggers but the one being read."""
