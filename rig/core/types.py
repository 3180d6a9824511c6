"""The values that travel through the rig. Imports numpy and nothing else."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")

Side = Literal["primary", "secondary"]
SIDES: tuple[Side, Side] = ("primary", "secondary")

PixelFormat = Literal["bayer_rggb8", "mono8"]
"""ROS 2 encoding names; `bayer_rggb8` has red at row 0, column 0."""

MAX_PAIR_OFFSET_NS = 500_000
"""Two exposures that begin further apart than this were not started by one pulse."""

Diagnostics = Mapping[str, float | str]


class Pair(NamedTuple, Generic[T]):
    """The same thing for the primary and the secondary camera."""

    primary: T
    secondary: T


@dataclass(frozen=True, slots=True)
class Limits:
    """Closed ranges of the settings that a camera, or its user, allows."""

    exposure_us: tuple[float, float] = (75.0, 30_000.0)
    gain_db: tuple[float, float] = (0.0, 30.0)

    def __post_init__(self) -> None:
        for name, (low, high) in (("exposure_us", self.exposure_us), ("gain_db", self.gain_db)):
            if not (math.isfinite(low) and math.isfinite(high) and low <= high):
                raise ValueError(f"{name} limits must be finite and ordered, got {low!r}..{high!r}")

    def __str__(self) -> str:
        """Return them as messages tell them: 75..30000 us and 0..30 dB."""
        (low_us, high_us), (low_db, high_db) = self.exposure_us, self.gain_db
        return f"{low_us:g}..{high_us:g} us and {low_db:g}..{high_db:g} dB"

    def within(self, outer: Limits) -> Limits:
        """Return the part of these limits that `outer` allows; ValueError when there is none."""
        return Limits(
            _overlap(self.exposure_us, outer.exposure_us), _overlap(self.gain_db, outer.gain_db)
        )


def _overlap(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    return max(a[0], b[0]), min(a[1], b[1])


THESIS_LIMITS = Limits()
"""75 us to 30 ms and 0 to 30 dB (thesis 4.2.5)."""


@dataclass(frozen=True, slots=True)
class Settings:
    """One exposure time and one analogue gain; finite, exposure > 0, gain >= 0."""

    exposure_us: float
    gain_db: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.exposure_us) and self.exposure_us > 0):
            raise ValueError(f"exposure_us must be finite and > 0, got {self.exposure_us!r}")
        if not (math.isfinite(self.gain_db) and self.gain_db >= 0):
            raise ValueError(f"gain_db must be finite and >= 0, got {self.gain_db!r}")

    def clamp(self, limits: Limits) -> Settings:
        """Return the nearest settings inside `limits`."""
        return Settings(
            min(max(self.exposure_us, limits.exposure_us[0]), limits.exposure_us[1]),
            min(max(self.gain_db, limits.gain_db[0]), limits.gain_db[1]),
        )


Metering = Literal["average", "lower", "partial", "spot"]
"""The part of the picture whose mean counts: all of it, its lower 70 %, or a middle part."""

Priority = Literal["gain", "exposure"]
"""What is kept low, in the words of the camera: gain (little noise) or exposure (little blur)."""


@dataclass(frozen=True, slots=True)
class Auto:
    """A command to the camera itself: expose on your own, inside these limits.

    `target_dn` is the mean grey of the 8-bit picture to aim for, 0..255. `damping` in [0, 1) is
    the share of each correction that is held back: 0 corrects at once. `start` is where the law
    begins; the camera keeps its state as long as the command stays equal. `metering` and `priority`
    are the camera's own AutoExposureMeteringMode and AutoExposureControlPriority; ValueError for a
    word that is neither.
    """

    limits: Limits = THESIS_LIMITS
    target_dn: float = 110.0
    damping: float = 0.5
    start: Settings = Settings(1_000.0, 0.0)
    metering: Metering = "average"
    priority: Priority = "gain"

    def __post_init__(self) -> None:
        for name, known in (("metering", get_args(Metering)), ("priority", get_args(Priority))):
            if getattr(self, name) not in known:
                raise ValueError(
                    f"{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}"
                )


Command = Settings | Auto


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One picture with what the camera says about it.

    `image` is uint8, H x W, in `pixel_format`. `sequence` counts triggers from 0. `used` are the
    settings that the picture was really taken with (chunk data on a real camera), which need not
    be those asked for.
    """

    image: NDArray[np.uint8]
    pixel_format: PixelFormat
    sequence: int
    device_time_ns: int
    host_time_ns: int
    used: Settings


@dataclass(frozen=True, slots=True)
class Lost:
    """A frame that did not come, and why: a missing frame is data."""

    sequence: int
    cause: str


@dataclass(frozen=True, slots=True)
class Decision:
    """What a controller said after a frame, and how long it took.

    `diagnostics` are the controller's own numbers and words. When the controller failed,
    `command` repeats the previous one and `diagnostics["held"]` says why.
    """

    controller: str
    command: Command
    latency_ms: float
    diagnostics: Diagnostics = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Truth:
    """What the simulation knows of one trigger: where the primary was and how bright it was.

    World frame as in REP 103: x forward along the road's start, y left, z up, metres.
    `orientation_xyzw` rotates the primary camera's optical frame (x right, y down, z forward) into
    the world. `light_cd_m2` is the mean radiance of the primary's view. `depth_m`, where it was
    asked for, is the distance along the primary's optical axis of every pixel (float32, H x W),
    infinite in the sky.
    """

    position_m: tuple[float, float, float]
    orientation_xyzw: tuple[float, float, float, float]
    light_cd_m2: float
    depth_m: NDArray[np.float32] | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class PairRecord:
    """Everything that one trigger left behind: the unit that is written, read and judged.

    `asked` is what the policy wanted for this trigger, `applied` what the cameras rounded it to;
    the frames carry what was `used`. `decisions` are those taken after this pair (for the next
    one); None where no controller stepped. `offset_ns` is secondary minus primary device time on
    the run's clock, None when a frame is missing.
    """

    trigger: int
    pose_index: int
    asked: Pair[Command]
    applied: Pair[Command]
    shot: Pair[Frame | Lost]
    decisions: Pair[Decision | None]
    offset_ns: int | None
    cause: str
    truth: Truth | None = None

    @property
    def complete(self) -> bool:
        """Return whether both frames came and belong together."""
        return self.cause == ""


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """Pinhole intrinsics in pixels of one picture size; `distortion` is k1 k2 p1 p2 k3 (Brown)."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
