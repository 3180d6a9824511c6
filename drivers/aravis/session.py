"""Both cameras set up as a pair, proven to be wired as they must be, and armed."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Literal, Protocol

from rig.core.clock import SystemClock
from rig.core.errors import CameraError, CameraLost, GrabTimeout
from rig.core.protocols import Clock
from rig.core.types import MAX_PAIR_OFFSET_NS, Frame, Pair, Settings
from rig.core.units import us_to_ns
from rig.drivers import blackfly
from rig.drivers.aravis.binding import Opened, look_around, open_camera
from rig.drivers.aravis.camera import ArmedCamera
from rig.drivers.aravis.times import TriggerLog
from rig.drivers.blackfly import Setup, camera_type
from rig.drivers.machine import USBFS_MB_GOOD, USBFS_MB_NEEDED, usbfs_memory_mb

_LOG = logging.getLogger(__name__)

Mode = Literal["next-frame", "free-run", "software"]
"""How frames are started.

`next-frame`: software triggers the primary, whose pulse triggers the secondary (thesis 5.1.1).
`free-run`: the primary exposes at its own pace. `software`: both are triggered by software, one
after the other, without a wire.
"""

MODES: tuple[Mode, ...] = ("next-frame", "free-run", "software")

PROOF = Pair(Settings(5_000.0, 0.0), Settings(1_000.0, 0.0))
"""Settings of the one shot that proves the wiring; the difference shows an inverted edge."""

_PROOF_TIMEOUT_S = 1.5
_FREE_RUN_MARGIN_US = 500.0


@dataclass(frozen=True, slots=True)
class PairSpec:
    """Which cameras, and how they are run. `names` are serial numbers or network addresses."""

    names: Pair[str]
    mode: Mode = "next-frame"
    rate_hz: float | None = 10.0
    packet_bytes: int | None = None
    setup: Setup = field(default_factory=Setup)


@dataclass(frozen=True, slots=True)
class Reach:
    """How cameras are reached: on which clock, and by what they are found and opened."""

    clock: Clock = field(default_factory=SystemClock)
    look_around: Callable[[Pair[str]], None] = look_around
    open_camera: Callable[[str], Opened] = open_camera


class Firing(Protocol):
    """How one trigger of the pair is fired."""

    def __call__(self, cameras: Pair[ArmedCamera], log: TriggerLog, clock: Clock) -> None:
        """Fire, and note when."""
        ...


def fire_primary(cameras: Pair[ArmedCamera], log: TriggerLog, clock: Clock) -> None:
    """Trigger the primary; its pulse does the rest."""
    before_ns = clock.now_ns()
    cameras.primary.fire()
    log.fired(before_ns, clock.now_ns())


def fire_both(cameras: Pair[ArmedCamera], log: TriggerLog, clock: Clock) -> None:
    """Trigger one camera after the other."""
    before_ns = clock.now_ns()
    for camera in cameras:
        camera.fire()
    log.fired(before_ns, clock.now_ns())


def await_next(cameras: Pair[ArmedCamera], log: TriggerLog, clock: Clock) -> None:
    """Take the next exposure that the primary begins on its own."""
    now_ns = clock.now_ns()
    log.fired(now_ns, now_ns)


_FIRING: dict[Mode, Firing] = {
    "next-frame": fire_primary,
    "free-run": await_next,
    "software": fire_both,
}


@dataclass(slots=True)
class Session:
    """Two armed cameras, from opening to the first loss."""

    cameras: Pair[ArmedCamera]
    log: TriggerLog
    clock: Clock
    fire_pair: Firing

    def fire(self) -> None:
        """Fire the next trigger; the clocks are kept in step meanwhile."""
        for camera in self.cameras:
            camera.keep_clock()
        self.fire_pair(self.cameras, self.log, self.clock)

    def close(self) -> None:
        """Stop in reverse order of the start, and let go of both cameras."""
        for camera in self.cameras:
            camera.close()


def open_session(spec: PairSpec, log: TriggerLog, reach: Reach) -> Session:
    """Open, set up, prove and arm a pair; raises CameraError with what is wrong."""
    with _opened(spec, log, reach) as cameras:
        if spec.mode == "software":
            for camera in cameras:
                camera.wait_for("software", *blackfly.software_trigger_steps())
        else:
            cameras.primary.wait_for("software", *blackfly.primary_steps())
            cameras.secondary.wait_for("line", *blackfly.secondary_steps())
            prove_wiring(cameras, reach.clock)
        if spec.mode == "free-run":
            assert spec.rate_hz is not None
            cameras.primary.carry_out(*blackfly.free_run_steps(spec.rate_hz))
            for camera in cameras:
                camera.limit_exposure(1e6 / spec.rate_hz - _FREE_RUN_MARGIN_US)
            log.by_trigger = False
        _start(cameras)
        return Session(cameras, log, reach.clock, _FIRING[spec.mode])


def prove_wiring(cameras: Pair[ArmedCamera], clock: Clock) -> None:
    """Take one pair and check that the secondary began with the primary, not with its end.

    Raises CameraError when no edge arrives, or when it arrives inverted. The cameras have their
    settings again afterwards and are stopped.
    """
    before = Pair(*(camera.present() for camera in cameras))
    logs = Pair(*(camera.log for camera in cameras))
    log = TriggerLog()
    for camera, settings in zip(cameras, PROOF, strict=True):
        camera.log = log
        camera.carry_out(*blackfly.settings_steps(settings))
    _start(cameras)
    fire_primary(cameras, log, clock)
    frames = Pair(_proof(cameras.primary), _proof_by_wire(cameras))
    for camera, settings, kept in zip(cameras, before, logs, strict=True):
        camera.stop()
        camera.carry_out(*blackfly.settings_steps(settings))
        camera.log = kept
    _judge(cameras, frames)


def _judge(cameras: Pair[ArmedCamera], frames: Pair[Frame]) -> None:
    offset_ns = frames.secondary.device_time_ns - frames.primary.device_time_ns
    if abs(offset_ns) <= MAX_PAIR_OFFSET_NS:
        _LOG.info("%s began %d ns after %s", cameras.secondary.serial, offset_ns, "the primary")
        return
    exposure_ns = us_to_ns(frames.primary.used.exposure_us)
    inverted = abs(offset_ns - exposure_ns) <= MAX_PAIR_OFFSET_NS
    what = (
        "began when the primary's exposure ended: the edge is inverted; check the pull-up, "
        "LineInverter and the polarity of the trigger wire"
        if inverted
        else f"began {offset_ns / 1e6:.3f} ms from the primary; check the trigger wire"
    )
    raise CameraError(f"{cameras.secondary.serial}: {what}")


def _proof(camera: ArmedCamera) -> Frame:
    try:
        return camera.grab(_PROOF_TIMEOUT_S)
    except GrabTimeout as error:
        raise CameraError(
            f"{camera.serial}: no picture after a software trigger: {error.cause}; "
            "check the link with rig doctor"
        ) from error


def _proof_by_wire(cameras: Pair[ArmedCamera]) -> Frame:
    primary, secondary = (camera.serial for camera in cameras)
    try:
        return cameras.secondary.grab(_PROOF_TIMEOUT_S)
    except GrabTimeout as error:
        raise CameraError(
            f"{secondary}: no picture when {primary} exposed: {error.cause}; check the trigger "
            f"wire from Line1 of {primary} to Line3 of {secondary}, or swap the two in --cameras"
        ) from error


def _start(cameras: Pair[ArmedCamera]) -> None:
    """Arm the secondary first, so that it misses no edge."""
    cameras.secondary.start()
    cameras.primary.start()


def refuse_small_usb_memory(usb_cameras: int, memory_mb: float | None) -> None:
    """Raise CameraError where the kernel has too little memory for two streams; 0 has no end."""
    if usb_cameras > 1 and memory_mb and memory_mb < USBFS_MB_NEEDED:
        raise CameraError(
            f"usbfs_memory_mb is {memory_mb:g}: two cameras on USB would lose transfers; "
            f"echo {USBFS_MB_GOOD} | sudo tee /sys/module/usbcore/parameters/usbfs_memory_mb"
        )


@contextlib.contextmanager
def _opened(spec: PairSpec, log: TriggerLog, reach: Reach) -> Iterator[Pair[ArmedCamera]]:
    """Open and configure both cameras; close them again when that fails, or what follows does."""
    cameras: list[ArmedCamera] = []
    try:
        reach.look_around(spec.names)
        for name in spec.names:
            opened = reach.open_camera(name)
            cameras.append(ArmedCamera(opened, camera_type(opened.maker), log, reach.clock))
            cameras[-1].configure(spec.setup, spec.packet_bytes)
        refuse_small_usb_memory(sum(camera.on_usb for camera in cameras), usbfs_memory_mb())
        yield Pair(*cameras)
    except (CameraError, CameraLost):
        for camera in cameras:
            camera.close()
        raise
