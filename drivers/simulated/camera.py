"""One simulated camera: trigger, exposure, readout and transfer, as the real one times them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rig.config import CameraModel
from rig.core.errors import CameraError, CameraLost, GrabTimeout
from rig.core.types import Command, Frame, Limits, Settings
from rig.core.units import s_to_ns, us_to_ns
from rig.drivers.simulated.program import ExposureProgram
from rig.drivers.simulated.world import Link, Wire, World

Overlap = Literal["off", "readout"]
"""When a trigger is taken: after the readout before, or already during it (`TriggerOverlap`)."""

TakePicture = Callable[[int, Settings], NDArray[np.uint8]]
"""Returns the picture of a trigger, counted from 0, taken with some settings."""


@dataclass(frozen=True, slots=True)
class Wiring:
    """How a camera is connected: who triggers it, what it drives, how its pictures leave."""

    world: World
    link: Link
    output: Wire
    software_trigger: bool
    overlap: Overlap


@dataclass(frozen=True, slots=True)
class Shot:
    """A picture on its way to the computer."""

    sequence: int
    start_ns: int
    used: Settings
    image: NDArray[np.uint8]


class SimulatedCamera:
    """A camera that takes its pictures from `take_picture`, at the times of `model`.

    A trigger that comes while the camera is busy is ignored and counted, as in the real one; its
    frame never comes, and `grab` says why.
    """

    def __init__(
        self,
        serial: str,
        model: CameraModel,
        wiring: Wiring,
        take_picture: TakePicture,
        latency_frames: int = 0,
    ) -> None:
        self._serial = serial
        self._model = model
        self._wiring = wiring
        self._take_picture = take_picture
        self._program = ExposureProgram(model.controls, latency_frames)
        self._software_triggers = 0
        self._exposure_end_ns = 0
        self._readout_end_ns = 0
        self._arrived: deque[Shot] = deque()
        self._refused: tuple[int, str] | None = None
        self._ignored = 0
        self._open = True

    @property
    def serial(self) -> str:
        """Return the serial number."""
        return self._serial

    @property
    def limits(self) -> Limits:
        """Return the settings that this camera can take."""
        return self._model.controls.limits

    @property
    def ignored_triggers(self) -> int:
        """Return how many triggers came while the camera was busy."""
        return self._ignored

    def apply(self, command: Command) -> Command:
        """Set what the next exposure uses; return the command clamped and rounded."""
        self._check_open()
        self._wiring.world.catch_up()
        return self._program.ask(command)

    def trigger(self) -> None:
        """Start one exposure; raises CameraError on a camera that listens to its wire."""
        self._check_open()
        if not self._wiring.software_trigger:
            raise CameraError(
                f"{self._serial}: triggered by its input line, not by software; "
                "trigger the primary camera"
            )
        self._wiring.world.catch_up()
        sequence = self._software_triggers
        self._software_triggers += 1
        self.on_trigger(self._wiring.world.clock.now_ns(), sequence)

    def grab(self, timeout_s: float) -> Frame:
        """Wait for the next frame; raises GrabTimeout with the cause that the camera knows."""
        self._check_open()
        world = self._wiring.world
        deadline_ns = world.clock.now_ns() + s_to_ns(timeout_s)
        if not world.run_until(lambda: bool(self._arrived), deadline_ns):
            cause, detail = self._why_no_frame()
            raise GrabTimeout(
                f"{self._serial}: no frame within {timeout_s:g} s; {cause}{detail}", cause
            )
        shot = self._arrived.popleft()
        return Frame(
            image=shot.image,
            pixel_format=self._model.picture.format,
            sequence=shot.sequence,
            device_time_ns=shot.start_ns,
            host_time_ns=world.clock.now_ns(),
            used=shot.used,
        )

    def next_arrived(self) -> Shot | None:
        """Return the next picture that came, without waiting; None when there is none."""
        return self._arrived.popleft() if self._arrived else None

    def close(self) -> None:
        """Close the camera; its frames are gone."""
        self._open = False
        self._arrived.clear()

    def on_trigger(self, time_ns: int, sequence: int) -> None:
        """Take the trigger `sequence`, from software or from the wire, if the camera is ready."""
        busy = self._busy(time_ns)
        if busy:
            self._ignored += 1
            self._refused = (sequence, busy)
            return
        self._refused = None
        used = self._program.next_exposure()
        self._exposure_end_ns = time_ns + us_to_ns(used.exposure_us)
        readout_start_ns = max(self._exposure_end_ns, self._readout_end_ns)
        self._readout_end_ns = readout_start_ns + s_to_ns(self._model.timing.readout_s)
        self._wiring.output.rise(time_ns, sequence)
        self._wiring.output.fall(self._exposure_end_ns, sequence)
        self._wiring.world.at(
            self._readout_end_ns, lambda now_ns: self._read_out(now_ns, sequence, time_ns, used)
        )

    def _busy(self, time_ns: int) -> str:
        """Return what keeps the camera from taking a trigger now; empty when it is ready."""
        if time_ns < self._exposure_end_ns:
            return "exposure"
        if self._wiring.overlap == "off" and time_ns < self._readout_end_ns:
            return "readout"
        return ""

    def _read_out(self, now_ns: int, sequence: int, start_ns: int, used: Settings) -> None:
        image = self._take_picture(sequence, used)
        self._program.saw(image)
        shot = Shot(sequence, start_ns, used, image)
        self._wiring.link.send(image.nbytes, now_ns, lambda over_ns: self._deliver(over_ns, shot))

    def _deliver(self, now_ns: int, shot: Shot) -> None:
        delivered_ns = now_ns + s_to_ns(self._model.timing.delivery_s)
        self._wiring.world.at(delivered_ns, lambda _: self._arrived.append(shot))

    def _why_no_frame(self) -> tuple[str, str]:
        """Return the cause in words that repeat, and what to add for this one frame."""
        if self._refused is not None:
            sequence, busy = self._refused
            advice = "wait for the frame before triggering again"
            return f"trigger ignored during {busy}", f" (trigger {sequence}): {advice}"
        if self._wiring.world.clock.now_ns() < self._readout_end_ns:
            return "exposure not over", ": allow more time than exposure and readout take"
        return "no trigger under way", ": trigger the primary camera first"

    def _check_open(self) -> None:
        if not self._open:
            raise CameraLost(f"{self._serial}: the camera is closed; open the cameras again")
