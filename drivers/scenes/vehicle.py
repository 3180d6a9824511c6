"""How the vehicle of every road world moves: its lane, its height, and how it shakes."""

from __future__ import annotations

import math

import numpy as np

from rig.drivers.scenes.street import LANE_M
from rig.drivers.scenes.trajectories import Drive, Knot, Path, Timetable, Wave

_CAMERA_HEIGHT_M = 1.4


def shaken_drive(
    rng: np.random.Generator,
    path: Path,
    speed_mps: float,
    *,
    roughness: tuple[Knot, ...] = (),
    timetable: Timetable | None = None,
) -> Drive:
    """Return a drive in the right lane whose weave, body motion and vibration `rng` varies.

    Each wave's amplitude is drawn within 25 % of the usual one, its frequency within 15 %.
    """

    def wave(amplitude: float, frequency_hz: float) -> Wave:
        drawn_amplitude = amplitude * rng.uniform(0.75, 1.25)
        drawn_hz = frequency_hz * rng.uniform(0.85, 1.15)
        return Wave(drawn_amplitude, drawn_hz, rng.uniform(0, 2 * math.pi))

    return Drive(
        path=path,
        speed_mps=speed_mps,
        lane_m=LANE_M,
        height_m=_CAMERA_HEIGHT_M,
        start_m=0.0,
        right=(wave(0.2, 0.08),),
        up=(wave(0.012, 1.4),),
        yaw=(wave(0.010, 0.15), wave(0.0009, 9.0), wave(0.0008, 15.0)),
        pitch=(wave(0.004, 1.4), wave(0.001, 11.0), wave(0.0012, 13.0), wave(0.0005, 24.0)),
        roll=(wave(0.003, 0.8), wave(0.0008, 11.0)),
        roughness=roughness,
        timetable=timetable,
    )
