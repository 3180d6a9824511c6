"""How a robot's camera moves through a building: it drives, turns on the spot, or stands."""

from __future__ import annotations

import math

import numpy as np

from rig.core.errors import UsageError
from rig.drivers.scenes.trajectories import Drive, Path, Wave

Waves = tuple[Wave, ...]

MOTIONS = ("linear", "rotating", "stationary")
DRIVE_S = 12.0


def read_motion(world: str, word: str) -> str:
    """Return the motion that an option names; raises UsageError for another word."""
    if word not in MOTIONS:
        raise UsageError(f"sim:{world}: motion must be {', '.join(MOTIONS)}, got {word!r}")
    return word


def robot_drive(
    rng: np.random.Generator,
    motion: str,
    speed_mps: float,
    start_m: float,
    height_m: float,
    *,
    right_m: float = 0.0,
    pan_rad: float = math.radians(65.0),
    pan_hz: float = 1 / 12.0,
) -> Drive:
    """Return a drive straight ahead (+z) from `start_m`, a pan, or a tripod's.

    A pan starts ahead and swings by `pan_rad` to one side, then to the other, `pan_hz` times a
    second.

    The speed is within 15 % of `speed_mps`. A small robot sways and nods with its wheels at about
    1.2 Hz and shakes at 8 to 16 Hz by about half a milliradian; the amplitudes are assumed.
    """

    def wave(amplitude: float, frequency_hz: float) -> Wave:
        size, pitch = rng.uniform(0.6, 1.4), rng.uniform(0.85, 1.15)
        return Wave(amplitude * size, frequency_hz * pitch, rng.uniform(0, 2 * math.pi))

    speed = speed_mps * float(rng.uniform(0.85, 1.15))
    yaw: Waves = (wave(0.02, 0.25), wave(0.004, 1.1), wave(0.0005, 9.0), wave(0.0004, 14.0))
    pitch: Waves = (wave(0.005, 1.2), wave(0.0006, 10.0), wave(0.0005, 16.0))
    roll: Waves = (wave(0.004, 1.1), wave(0.0005, 12.0))
    sway: Waves = (wave(0.03, 0.3),)
    heave: Waves = (wave(0.006, 1.2),)
    if motion == "stationary":
        yaw = pitch = roll = sway = heave = ()
    if motion == "rotating":
        pan = Wave(pan_rad * float(rng.choice([-1.0, 1.0])), pan_hz, 0.0)
        yaw, sway = (pan, *yaw[1:]), ()
    return Drive(
        path=Path((), 60.0),
        speed_mps=speed if motion == "linear" else 0.0,
        lane_m=right_m,
        height_m=height_m,
        start_m=start_m,
        right=sway,
        up=heave,
        yaw=yaw,
        pitch=pitch,
        roll=roll,
    )
