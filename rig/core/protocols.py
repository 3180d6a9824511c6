"""The seams of the rig. Every room depends on these, never on a neighbour."""

from __future__ import annotations

from typing import Protocol, Self

from rig.core.types import (
    Command,
    Decision,
    Diagnostics,
    Frame,
    Intrinsics,
    Limits,
    Pair,
    PairRecord,
    Truth,
)


class Clock(Protocol):
    """Monotonic time: the computer's, or a simulation's."""

    def now_ns(self) -> int:
        """Return the time in nanoseconds."""
        ...

    def sleep_s(self, duration_s: float) -> None:
        """Let `duration_s` pass; nothing happens for a duration <= 0."""
        ...


class Camera(Protocol):
    """One armed camera, owned by the thread that opened it."""

    @property
    def serial(self) -> str:
        """Return the serial number that is printed on the camera."""
        ...

    @property
    def limits(self) -> Limits:
        """Return the settings that this camera can take."""
        ...

    def apply(self, command: Command) -> Command:
        """Set what the next exposure uses; return the command as the camera rounded it."""
        ...

    def trigger(self) -> None:
        """Start one exposure by software."""
        ...

    def grab(self, timeout_s: float) -> Frame:
        """Wait for the triggered frame; raises GrabTimeout or CameraLost."""
        ...

    def close(self) -> None:
        """Stop and release the camera; closing twice is harmless."""
        ...


class Controller(Protocol):
    """Looks at a frame and says how to take the next one. Pure: no clock, no files."""

    def reset(self, limits: Limits) -> Command:
        """Forget all history and return the first command."""
        ...

    def step(self, frame: Frame) -> Command:
        """Return the command for the next frame."""
        ...

    def diagnostics(self) -> Diagnostics:
        """Return what the last step was thinking, for the recording."""
        ...


class PairPolicy(Protocol):
    """Chooses the commands of both cameras from the last complete pair."""

    @property
    def names(self) -> Pair[str]:
        """Return the name under which each side's decisions are recorded."""
        ...

    def reset(self, limits: Pair[Limits]) -> Pair[Command]:
        """Forget all history and return the first commands."""
        ...

    def decide(self, frames: Pair[Frame]) -> Pair[Decision]:
        """Return the decisions for the next pair. Never raises for a controller's failure."""
        ...


class Source(Protocol):
    """An opened pair of cameras with what belongs to it: `--cameras` made real."""

    @property
    def address(self) -> str:
        """Return the address that was opened, with every option resolved."""
        ...

    @property
    def cameras(self) -> Pair[Camera]:
        """Return the two cameras, armed: a trigger of the primary exposes both."""
        ...

    @property
    def intrinsics(self) -> Pair[Intrinsics]:
        """Return the pinhole intrinsics of both cameras at the picture size in use."""
        ...

    @property
    def clock(self) -> Clock:
        """Return the clock that the cameras' device times are on."""
        ...

    @property
    def real_time(self) -> bool:
        """Return whether time runs by itself, so that a late recorder loses frames."""
        ...

    @property
    def rate_hz(self) -> float | None:
        """Return the pace of the triggers; None is as fast as the exposures allow."""
        ...

    @property
    def decision_ms(self) -> float:
        """Return how much simulated time a decision costs; 0 where time runs by itself."""
        ...

    @property
    def drive_triggers(self) -> int | None:
        """Return how many triggers the whole drive has; None is without end."""
        ...

    @property
    def world_version(self) -> str:
        """Return the version of the simulated world; empty for real cameras."""
        ...

    def pose_index(self, trigger: int) -> int:
        """Return the pose that a trigger looks from; equal indices see the same scene."""
        ...

    def truth(self, trigger: int) -> Truth | None:
        """Return what the simulation knows of a trigger that was fired; None without one."""
        ...

    def close(self) -> None:
        """Close both cameras."""
        ...


class Recorder(Protocol):
    """Takes records without blocking the loop; owns the only other thread."""

    def write(self, record: PairRecord) -> None:
        """Queue one record."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...
