"""A little drive with three changes of light, by which the defaults of every rival are frozen."""

from __future__ import annotations

from typing import Any

import numpy as np

from rig.controllers.registry import ALIASES, CONTROLLERS, make_controller
from rig.core.autoexposure import AutoExposure, metered_dn
from rig.core.types import THESIS_LIMITS, Auto, Frame, Settings
from rig.core.units import gain_factor

SHAPE = (96, 128)
LIGHTS_DN_PER_US = (0.2, 0.01, 0.05)
FRAMES_A_LIGHT = 30
NOT_FROZEN = {"network"}
"""What a network does is frozen by its file."""


def rivals() -> list[str]:
    """Return the names of all controllers that have defaults of their own."""
    return sorted({*CONTROLLERS, *ALIASES, "aeag:preset=vendor"} - NOT_FROZEN)


def trace(spec: str) -> dict[str, Any]:
    """Return a controller's options and the settings that it used in every frame.

    Exposures are in us, gains in dB, both rounded to what no library's last digit moves.
    """
    named = make_controller(spec, seed=0, networks={})
    command = named.controller.reset(THESIS_LIMITS)
    law: AutoExposure | None = None
    used: list[list[float]] = []
    for number in range(FRAMES_A_LIGHT * len(LIGHTS_DN_PER_US)):
        if isinstance(command, Auto):
            law = law or AutoExposure.begun(command)
            settings = law.settings
        else:
            settings = rounded(command)
        frame = shoot(number, settings)
        used.append([round(settings.exposure_us, 1), round(settings.gain_db, 2)])
        if law is not None and isinstance(command, Auto):
            law = law.after(metered_dn(frame.image, command.metering))
        command = named.controller.step(frame)
    return {"options": dict(named.options), "used": used}


def rounded(settings: Settings) -> Settings:
    """Return settings on a camera's steps."""
    return Settings(float(round(settings.exposure_us)), round(settings.gain_db, 1))


def shoot(number: int, settings: Settings) -> Frame:
    """Return a noisy frame of a wall of stones."""
    stones = np.random.default_rng(1).uniform(0.05, 1.0, (SHAPE[0] // 6, SHAPE[1] // 8))
    wall = np.repeat(np.repeat(stones, 6, axis=0), 8, axis=1)
    light = LIGHTS_DN_PER_US[number // FRAMES_A_LIGHT]
    noise = np.random.default_rng(number).normal(0, 0.5, SHAPE)
    gain = gain_factor(settings.gain_db)
    grey = wall * light * settings.exposure_us * gain + noise * gain
    image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    return Frame(image, "bayer_rggb8", number, 0, 0, settings)
