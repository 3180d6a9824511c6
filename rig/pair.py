"""Two cameras, one trigger: pacing, pairing, and the proof that two frames belong together.

The primary is triggered by software; its exposure pulse triggers the secondary over a wire
(thesis 5.1.1). A pair is complete only when both frames came, carry the same trigger count, and
began within `MAX_PAIR_OFFSET_NS` of each other. Whatever else happens is data: a `Lost` with its
cause.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from rig.core.errors import CameraError, GrabTimeout
from rig.core.protocols import Camera, Source
from rig.core.types import (
    MAX_PAIR_OFFSET_NS,
    THESIS_LIMITS,
    Command,
    Frame,
    Limits,
    Lost,
    Pair,
    Side,
)
from rig.core.units import NS_PER_S, us_to_ns

GRAB_MARGIN_S = 1.0
"""Time beyond the longest exposure after which a frame is not coming any more."""


@dataclass(frozen=True, slots=True)
class PairShot:
    """What one trigger brought: two frames or losses, and why the pair is not whole."""

    frames: Pair[Frame | Lost]
    offset_ns: int | None
    cause: str


def both_frames(shot: PairShot) -> Pair[Frame] | None:
    """Return the two frames of a whole pair; None when anything was lost."""
    primary, secondary = shot.frames
    if shot.cause or isinstance(primary, Lost) or isinstance(secondary, Lost):
        return None
    return Pair(primary, secondary)


@dataclass(slots=True)
class CameraPair:
    """The cameras of a source, fired together and checked against each other."""

    source: Source
    allowed: Limits = THESIS_LIMITS
    triggers: int = 0
    first_trigger_ns: int | None = field(default=None)

    @property
    def limits(self) -> Pair[Limits]:
        """Return what both cameras can take, inside what the rig allows.

        Raises CameraError for a camera that can take nothing of it.
        """
        return Pair(*(_limits(camera, self.allowed) for camera in self.source.cameras))

    def apply(self, commands: Pair[Command]) -> Pair[Command]:
        """Set what the next exposures use; return the commands as the cameras rounded them."""
        primary, secondary = self.source.cameras
        return Pair(primary.apply(commands.primary), secondary.apply(commands.secondary))

    def shoot(self) -> PairShot:
        """Fire trigger number `triggers` at its time and collect what comes.

        Raises CameraLost when a camera stopped answering; a frame that merely did not come is
        returned as `Lost`.
        """
        self.source.clock.sleep_s(self.source.decision_ms * 1e-3)
        self._wait_for_turn()
        trigger = self.triggers
        self.triggers += 1
        self.source.cameras.primary.trigger()
        timeout_s = GRAB_MARGIN_S + self.allowed.exposure_us[1] * 1e-6
        primary, secondary = self.source.cameras
        return _paired(
            Pair(
                _grab("primary", primary, trigger, timeout_s),
                _grab("secondary", secondary, trigger, timeout_s),
            )
        )

    def _wait_for_turn(self) -> None:
        """Sleep until trigger k may fire: at k / rate after the first, or at once when late."""
        now_ns = self.source.clock.now_ns()
        if self.first_trigger_ns is None:
            self.first_trigger_ns = now_ns
        if self.source.rate_hz is not None:
            due_ns = self.first_trigger_ns + round(self.triggers / self.source.rate_hz * NS_PER_S)
            self.source.clock.sleep_s((due_ns - now_ns) / NS_PER_S)


def _limits(camera: Camera, allowed: Limits) -> Limits:
    try:
        return camera.limits.within(allowed)
    except ValueError:
        raise CameraError(
            f"{camera.serial}: takes {camera.limits}, of which the rig's {allowed} leave nothing; "
            "use another camera, or correct its camera file"
        ) from None


def _grab(side: Side, camera: Camera, trigger: int, timeout_s: float) -> Frame | Lost:
    """Take this trigger's frame; one that comes late for an earlier trigger is passed over."""
    try:
        frame = camera.grab(timeout_s)
        while frame.sequence < trigger:
            frame = camera.grab(timeout_s)
    except GrabTimeout as error:
        return Lost(trigger, f"{side}: {error.cause}")
    return frame if frame.sequence == trigger else Lost(trigger, f"{side}: trigger count ran ahead")


def _paired(frames: Pair[Frame | Lost]) -> PairShot:
    primary, secondary = frames
    if isinstance(primary, Lost) or isinstance(secondary, Lost):
        causes = [frame.cause for frame in frames if isinstance(frame, Lost)]
        return PairShot(frames, None, "; ".join(dict.fromkeys(causes)))
    offset_ns = secondary.device_time_ns - primary.device_time_ns
    return PairShot(frames, offset_ns, _why_apart(primary, offset_ns))


def _why_apart(primary: Frame, offset_ns: int) -> str:
    """Return what is wrong with the offset of two exposures; empty when they began together.

    An edge that is inverted comes with the end of the primary's exposure, so the offset follows it.
    """
    if abs(offset_ns) <= MAX_PAIR_OFFSET_NS:
        return ""
    if abs(offset_ns - us_to_ns(primary.used.exposure_us)) <= MAX_PAIR_OFFSET_NS:
        return "secondary: began as the primary's exposure ended (inverted trigger edge)"
    return "exposures did not begin together"
