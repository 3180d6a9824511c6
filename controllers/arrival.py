"""Whether a frame was taken with the settings that were asked for."""

from __future__ import annotations

from dataclasses import dataclass

from rig.core.types import Settings

ARRIVED_RATIO, ARRIVED_DB = 0.01, 0.1
WAIT_FRAMES_MAX = 8
"""A frame taken with other settings than asked is waited for, but not longer than this."""


@dataclass(slots=True)
class Arrival:
    """Waits for late settings, so that a search takes no frame for one that it did not ask for."""

    waited_frames: int = 0

    def due(self, used: Settings, asked: Settings) -> bool:
        """Return whether to go on with a frame: it came as asked, or was waited for too long."""
        if not arrived(used, asked) and self.waited_frames < WAIT_FRAMES_MAX:
            self.waited_frames += 1
            return False
        self.waited_frames = 0
        return True


def arrived(used: Settings, asked: Settings) -> bool:
    """Return whether `used` is `asked` but for the camera's rounding."""
    return (
        abs(used.exposure_us / asked.exposure_us - 1) <= ARRIVED_RATIO
        and abs(used.gain_db - asked.gain_db) <= ARRIVED_DB
    )
