"""What a picture that is all white or all dark asks for, whatever a network answers.

At the mouth of a tunnel a network nears the new brightness in small steps, for a step that is too
large breaks the matches that are left. In a picture that is all white or all dark few are left, so
little is lost by going at once where there may be many. Drives hardly ever come to this: it is for
light that jumps, such as a lamp that is switched or a door that opens. The constants were found
on train roads (docs/learning-trials.md).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rig.controllers.split import brightness_us
from rig.core.types import Limits, Settings
from rig.core.units import gain_db, gain_factor

WHITE = 0.95
"""Share of saturated pixels above which a picture is white."""

DARK, ALL = 0.25, 0.98
"""A picture is dark where more than the share `ALL` of its cells is below `DARK` of full scale."""

LEAP_EV = 3.0
"""What is gone at once: a white picture does not tell how much too bright it is."""

MIDDLE = 0.47
"""The mean that a dark picture should have had, as a share of full scale: a usual one."""

_DARKEST = 1 / 255


def startled(
    glance: NDArray[np.float32], used: Settings, answer: Settings, limits: Limits
) -> Settings:
    """Return `answer`, or what leads out of the dark or the white where it does not.

    `glance` is 2 x rows x columns, brightness and share of saturated pixels of cells in 0..1, of a
    picture taken with `used`. What is returned after a white picture is at least `LEAP_EV` stops
    darker than `used`, after a dark one as much brighter as lifts its mean to `MIDDLE`, at most
    `LEAP_EV` stops; half of it by exposure time and half by gain, inside `limits`.
    """
    cells, saturated = glance
    seen_us, answered_us = brightness_us(used), brightness_us(answer)
    wanted_us = answered_us
    if saturated.mean() > WHITE:
        wanted_us = min(answered_us, seen_us / 2**LEAP_EV)
    elif (cells < DARK).mean() > ALL:
        lift = min(MIDDLE / max(float(cells.mean()), _DARKEST), 2**LEAP_EV)
        wanted_us = max(answered_us, seen_us * lift)
    return answer if wanted_us == answered_us else _as_bright_as(wanted_us, answer, limits)


def _as_bright_as(wanted_us: float, answer: Settings, limits: Limits) -> Settings:
    """Return settings of a brightness, as far from `answer` in exposure as in gain if they can."""
    shortest_us, longest_us = limits.exposure_us
    halfway_us = answer.exposure_us * math.sqrt(wanted_us / brightness_us(answer))
    exposure_us = min(max(halfway_us, shortest_us), longest_us)
    lowest_db, highest_db = limits.gain_db
    gain = min(max(gain_db(wanted_us / exposure_us), lowest_db), highest_db)
    return Settings(wanted_us / gain_factor(gain), gain).clamp(limits)
