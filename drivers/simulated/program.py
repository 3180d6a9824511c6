"""From commands to the settings of each exposure: rounding, delay, and the camera's own law."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rig.config import Controls
from rig.core.autoexposure import AutoExposure, metered_dn
from rig.core.types import Auto, Command, Limits, Settings


class ExposureProgram:
    """Decides what each exposure of one camera uses.

    A command counts from the exposure that is `latency_frames` after the next one. The camera's
    own law (`Auto`) corrects the next exposure whatever the latency: it sits beside the sensor.
    """

    def __init__(self, controls: Controls, latency_frames: int) -> None:
        self._controls = controls
        self._latency_frames = latency_frames
        self._exposures = 0
        self._waiting: deque[tuple[int, Command]] = deque()
        self._command: Command = Settings(controls.initial_exposure_us, controls.initial_gain_db)
        self._law: AutoExposure | None = None

    def ask(self, command: Command) -> Command:
        """Take a command for a coming exposure; return it as rounded."""
        rounded = round_command(command, self._controls)
        self._waiting.append((self._exposures + self._latency_frames, rounded))
        return rounded

    def next_exposure(self) -> Settings:
        """Return what the exposure that begins now uses."""
        while self._waiting and self._waiting[0][0] <= self._exposures:
            self._become(self._waiting.popleft()[1])
        self._exposures += 1
        if isinstance(self._command, Settings):
            return self._command
        assert self._law is not None
        return round_settings(self._law.settings, self._law.limits, self._controls)

    def saw(self, image: NDArray[np.uint8]) -> None:
        """Show the camera's own law, where that is at work, a picture that was read out."""
        if self._law is not None and isinstance(self._command, Auto):
            self._law = self._law.after(metered_dn(image, self._command.metering))

    def _become(self, command: Command) -> None:
        if command == self._command:
            return
        self._command = command
        self._law = AutoExposure.begun(command) if isinstance(command, Auto) else None


def round_command(command: Command, controls: Controls) -> Command:
    """Return `command` as the camera can take it: inside its limits and on its steps."""
    if isinstance(command, Settings):
        return round_settings(command, controls.limits, controls)
    limits = _inside(command.limits, controls.limits)
    return replace(command, limits=limits, start=round_settings(command.start, limits, controls))


def round_settings(settings: Settings, limits: Limits, controls: Controls) -> Settings:
    """Return the nearest settings on the camera's steps inside `limits`."""
    return Settings(
        _snap(settings.exposure_us, limits.exposure_us, controls.exposure_step_us),
        _snap(settings.gain_db, limits.gain_db, controls.gain_step_db),
    )


def _snap(value: float, limits: tuple[float, float], step: float) -> float:
    tolerance = 1e-6
    lowest = math.ceil(limits[0] / step - tolerance)
    highest = math.floor(limits[1] / step + tolerance)
    return round(min(max(round(value / step), lowest), highest) * step, 9)


def _inside(limits: Limits, bounds: Limits) -> Limits:
    """Return `limits` with each end moved into `bounds`."""
    low = Settings(limits.exposure_us[0], limits.gain_db[0]).clamp(bounds)
    high = Settings(limits.exposure_us[1], limits.gain_db[1]).clamp(bounds)
    return Limits((low.exposure_us, high.exposure_us), (low.gain_db, high.gain_db))
