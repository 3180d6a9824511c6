"""A pair of cameras behind Aravis as the loop sees it, through losses and returns."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field

from rig.core.errors import CameraError, CameraLost, GrabTimeout
from rig.core.protocols import Camera, Clock
from rig.core.types import Command, Frame, Intrinsics, Limits, Pair, Settings, Truth
from rig.core.units import NS_PER_S
from rig.drivers.aravis.session import PairSpec, Reach, Session, open_session
from rig.drivers.aravis.times import TriggerLog

_LOG = logging.getLogger(__name__)

GIVE_UP_S = 60.0
"""How long lost cameras are waited for."""

_RETRY_S = 0.5
_PATIENCE_S = 0.2
_FOCAL_LENGTH_PER_WIDTH = 1806.0 / 2048.0
_NAMES = Pair("primary", "secondary")


class Segments:
    """The sessions of one run: when a camera is lost, both are opened again from scratch.

    While cameras are lost triggers are counted and no frame comes; the cause names the segment
    that ended, so a recording shows where one segment ends and the next begins. Raises CameraLost
    when they do not return within GIVE_UP_S.
    """

    def __init__(self, spec: PairSpec, reach: Reach) -> None:
        self._spec = spec
        self._reach = reach
        self._clock = reach.clock
        self._log = TriggerLog()
        self._session: Session | None = open_session(spec, self._log, reach)
        self._number = 1
        self._lost_ns = 0
        self._tried_ns = 0
        self._closed = False

    @property
    def number(self) -> int:
        """Return the segment of the run, counted from 1."""
        return self._number

    @property
    def cause(self) -> str:
        """Return why no frame comes while cameras are lost."""
        return f"camera lost, segment {self._number} ended"

    def current(self, serial: str) -> Session | None:
        """Return the session, opened again where it was lost; None while it cannot be."""
        if self._closed:
            raise CameraLost(f"{serial}: the camera is closed; open the cameras again")
        if self._session is None:
            self._open_again(serial)
        return self._session

    def running(self, serial: str) -> Session | None:
        """Return the session as it is; None while cameras are lost."""
        if self._closed:
            raise CameraLost(f"{serial}: the camera is closed; open the cameras again")
        return self._session

    def lost(self, error: CameraLost) -> None:
        """End the segment."""
        if self._session is None:
            return
        _LOG.warning("%s; segment %d ends", error, self._number)
        self._session.close()
        self._session = None
        self._lost_ns = self._tried_ns = self._clock.now_ns()

    def fire(self, serial: str) -> None:
        """Fire a trigger, or count it while cameras are lost."""
        session = self.running(serial)
        counted = self._log.count
        if session is not None:
            try:
                session.fire()
            except CameraLost as error:
                self.lost(error)
        if self._log.count == counted:
            self._log.passed()

    def close(self) -> None:
        """Close both cameras."""
        self._closed = True
        if self._session is not None:
            self._session.close()
        self._session = None

    def _open_again(self, serial: str) -> None:
        now_ns = self._clock.now_ns()
        if now_ns - self._tried_ns < _RETRY_S * NS_PER_S:
            return
        try:
            self._session = open_session(self._spec, self._log, self._reach)
        except CameraError as error:
            self._tried_ns = self._clock.now_ns()
            if self._tried_ns - self._lost_ns > GIVE_UP_S * NS_PER_S:
                raise CameraLost(
                    f"{serial}: gone for over {GIVE_UP_S:g} s ({error}); plug it in and start again"
                ) from error
            return
        self._number += 1
        _LOG.warning("%s: both cameras are back; segment %d begins", serial, self._number)


class SegmentCamera:
    """One camera of the pair, whichever session it is in; implements `Camera`."""

    def __init__(self, segments: Segments, side: int, clock: Clock) -> None:
        self._segments = segments
        self._side = side
        self._clock = clock
        session = segments.running("")
        assert session is not None
        self._serial = session.cameras[side].serial
        self._limits = session.cameras[side].limits

    @property
    def serial(self) -> str:
        """Return the serial number."""
        return self._serial

    @property
    def limits(self) -> Limits:
        """Return the settings that this camera takes."""
        return self._limits

    def apply(self, command: Command) -> Command:
        """Set what the next exposure uses; return the command as the camera rounded it."""
        session = self._segments.current(self._serial)
        if session is not None:
            try:
                return session.cameras[self._side].apply(command)
            except CameraLost as error:
                self._segments.lost(error)
        return command.clamp(self._limits) if isinstance(command, Settings) else command

    def trigger(self) -> None:
        """Fire the pair; raises CameraError on the secondary."""
        if self._side:
            self._segments.running(self._serial)
            raise CameraError(
                f"{self._serial}: triggered by its input line, not by software; "
                "trigger the primary camera"
            )
        self._segments.fire(self._serial)

    def grab(self, timeout_s: float) -> Frame:
        """Wait for a frame; raises GrabTimeout, also while cameras are lost."""
        session = self._segments.running(self._serial)
        if session is not None:
            try:
                return session.cameras[self._side].grab(timeout_s)
            except CameraLost as error:
                self._segments.lost(error)
        self._clock.sleep_s(min(timeout_s, _PATIENCE_S))
        cause = self._segments.cause
        raise GrabTimeout(f"{self._serial}: no frame; {cause}", cause)

    def close(self) -> None:
        """Close the pair."""
        self._segments.close()


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What is known of the run beside the cameras; nothing of a real place.

    Every trigger looks from a new pose, unless a simulation behind the cameras stands still.
    """

    address: str
    intrinsics: Pair[Intrinsics] | None = None
    drive_triggers: int | None = None
    world_version: str = ""
    truth: Callable[[int], Truth | None] = lambda _: None
    pose_index: Callable[[int], int] = lambda trigger: trigger


@dataclass(frozen=True, slots=True)
class AravisSource:
    """The opened pair; implements `rig.core.protocols.Source`."""

    surroundings: Surroundings
    spec: PairSpec
    segments: Segments
    cameras: Pair[Camera]
    clock: Clock
    also_close: Callable[[], None] = lambda: None
    real_time: bool = field(default=True, init=False)
    decision_ms: float = field(default=0.0, init=False)

    @property
    def address(self) -> str:
        """Return the address that was opened."""
        return self.surroundings.address

    @property
    def intrinsics(self) -> Pair[Intrinsics]:
        """Return the intrinsics of both cameras: known ones, or those of the thesis' lens."""
        if self.surroundings.intrinsics is not None:
            return self.surroundings.intrinsics
        session = self.segments.running(_NAMES.primary)
        assert session is not None
        return Pair(*(_intrinsics(camera.size_px) for camera in session.cameras))

    @property
    def rate_hz(self) -> float | None:
        """Return the pace of the triggers; None follows cameras that run freely."""
        return None if self.spec.mode == "free-run" else self.spec.rate_hz

    @property
    def drive_triggers(self) -> int | None:
        """Return how many triggers the drive has; None without end."""
        return self.surroundings.drive_triggers

    @property
    def world_version(self) -> str:
        """Return the version of the simulated world; empty for real cameras."""
        return self.surroundings.world_version

    def pose_index(self, trigger: int) -> int:
        """Return the number of the pose that a trigger looks from."""
        return self.surroundings.pose_index(trigger)

    def truth(self, trigger: int) -> Truth | None:
        """Return what a simulation behind the cameras knows of a trigger.

        That is nothing after a loss: cameras that are opened again begin their drive again.
        """
        return self.surroundings.truth(trigger) if self.segments.number == 1 else None

    def close(self) -> None:
        """Close both cameras."""
        self.segments.close()
        self.also_close()


def open_pair(
    spec: PairSpec,
    surroundings: Surroundings,
    also_close: Callable[[], None] = lambda: None,
    reach: Reach | None = None,
) -> AravisSource:
    """Open a pair; raises CameraError with what is wrong."""
    reach = reach or Reach()
    segments = Segments(spec, reach)
    cameras = Pair[Camera](*(SegmentCamera(segments, side, reach.clock) for side in range(2)))
    return AravisSource(surroundings, spec, segments, cameras, reach.clock, also_close)


def _intrinsics(size_px: tuple[int, int]) -> Intrinsics:
    """Return the thesis' field of view at a picture size, for cameras without a calibration."""
    width_px, height_px = size_px
    focal_px = _FOCAL_LENGTH_PER_WIDTH * width_px
    return Intrinsics(
        width_px, height_px, focal_px, focal_px, (width_px - 1) / 2, (height_px - 1) / 2
    )
