"""The exact node writes that make two Blackfly S a triggered pair, in order.

Everything here is a pure function from a setup to a list of steps, carried out on a small seam,
`NodeMap`; nothing knows how nodes travel to a camera. What a camera type calls its nodes, and which
of them it may lack, stands in a `CameraType`, so another vendor is data. Order and reasons: a
trigger is off while its source changes; lines are set before they matter; pixels before chunks;
the limits of the camera's own exposure control before that control.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from rig.core.autoexposure import LOWER_SHARE
from rig.core.errors import CameraError
from rig.core.types import Auto, Limits, Metering, Priority, Settings

_LOG = logging.getLogger(__name__)

Value = bool | int | float | str


class NodeMap(Protocol):
    """The named nodes of one camera; each method raises CameraError when the camera refuses."""

    @property
    def serial(self) -> str:
        """Return the serial number."""
        ...

    def has(self, name: str) -> bool:
        """Return whether there is such a node."""
        ...

    def writable(self, name: str) -> bool:
        """Return whether the node can be written now."""
        ...

    def read(self, name: str) -> Value:
        """Return the value of a node."""
        ...

    def write(self, name: str, value: Value) -> None:
        """Write a node."""
        ...

    def execute(self, name: str) -> None:
        """Run a command node."""
        ...

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the lowest and highest value that a number takes now."""
        ...

    def entries(self, name: str) -> Sequence[str]:
        """Return the words that an enumeration takes."""
        ...


class End(str):
    """Stands for an end of a number's range, as it is when the step is carried out."""


LOWEST, HIGHEST = End("lowest"), End("highest")
LOWER = End("lower part")
"""Stands for the rows of the lower part of a number of rows, where that is the highest."""

PIXEL_STEP = 4
"""Regions begin and end on multiples of this."""


@dataclass(frozen=True, slots=True)
class Write:
    """Write a node; numbers are clamped to the node's range, LOWEST and HIGHEST are its ends.

    With `skip_if_locked` a node that cannot be written now is left as it is.
    """

    node: str
    value: Value
    skip_if_locked: bool = False


@dataclass(frozen=True, slots=True)
class Execute:
    """Run a command node."""

    node: str


Step = Write | Execute


@dataclass(frozen=True, slots=True)
class CameraType:
    """What a type of camera calls its nodes, and which of them it may lack.

    `aliases` name what to use where a node is missing; `optional` nodes may be missing without
    harm. Any other missing node is an error.
    """

    name: str
    optional: frozenset[str]
    aliases: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def resolve(self, nodes: NodeMap, name: str) -> str | None:
        """Return what the camera calls a node; None for an optional one that it lacks.

        Raises CameraError for a node that is missing and needed.
        """
        for candidate in (name, *self.aliases.get(name, ())):
            if nodes.has(candidate):
                return candidate
        if name in self.optional:
            return None
        raise CameraError(
            f"{nodes.serial}: has no node {name}, which a {self.name} needs; "
            "check that this is the right camera, or name an alias in drivers/blackfly.py"
        )


BLACKFLY_S = CameraType(
    name="Blackfly S",
    optional=frozenset(
        {
            "AasRoiEnable",
            "AasRoiHeight",
            "AasRoiOffsetX",
            "AasRoiOffsetY",
            "AasRoiWidth",
            "AcquisitionFrameRateEnable",
            "AutoAlgorithmSelector",
            "AutoExposureControlLoopDamping",
            "AutoExposureControlPriority",
            "AutoExposureExposureTimeLowerLimit",
            "AutoExposureGainLowerLimit",
            "AutoExposureGainUpperLimit",
            "AutoExposureMeteringMode",
            "AutoExposureTargetGreyValueAuto",
            "BinningHorizontal",
            "BinningVertical",
            "BlackLevel",
            "CounterEventSource",
            "CounterSelector",
            "DeviceLinkThroughputLimit",
            "ExposureMode",
            "GammaEnable",
            "LineInverter",
            "OffsetX",
            "OffsetY",
            "TriggerActivation",
            "TriggerDelay",
            "TriggerOverlap",
            "V3_3Enable",
        }
    ),
    aliases={
        "ExposureTime": ("ExposureTimeAbs",),
        "Gain": ("GainAbs",),
        "AcquisitionFrameRateEnable": ("AcquisitionFrameRateEnabled",),
        "AcquisitionFrameRate": ("AcquisitionFrameRateAbs",),
        "GammaEnable": ("GammaEnabled",),
        "TimestampLatch": ("GevTimestampControlLatch",),
        "TimestampLatchValue": ("TimestampLatchedValue", "GevTimestampValue"),
    },
)
"""The camera of the thesis (5.1.1); names as in the vendor's feature reference."""


ARAVIS_FAKE = CameraType(
    name="fake camera of Aravis",
    optional=BLACKFLY_S.optional
    | {
        "AutoExposureExposureTimeUpperLimit",
        "ChunkEnable",
        "ChunkModeActive",
        "ChunkSelector",
        "ExposureAuto",
        "TimestampLatch",
        "TimestampLatchValue",
    },
    aliases={"ExposureTime": ("ExposureTimeAbs",), "Gain": ("GainRaw",)},
)
"""What Aravis itself simulates: no chunks, no clock that can be latched, gain in whole steps."""


def camera_type(maker: str) -> CameraType:
    """Return the type of a camera by its vendor and model."""
    return ARAVIS_FAKE if maker.startswith("Aravis ") else BLACKFLY_S


@dataclass(frozen=True, slots=True)
class Setup:
    """What every camera of the pair is set up with.

    `exposure_us_max` bounds the camera's own exposure control; `link_bytes_per_s` is each camera's
    share of the cable.
    """

    exposure_us_max: float = 30_000.0
    link_bytes_per_s: int = 190_000_000
    black_level: float = 0.0


CHUNKS = ("FrameID", "Timestamp", "ExposureTime", "Gain")
"""What every picture carries: the truth about the settings that it was taken with."""


def open_steps(nodes: NodeMap, setup: Setup, pixel_format: str) -> Iterator[Step]:
    """Yield what both cameras are told first: stop, no triggers, full pictures, fixed settings."""
    yield Execute("AcquisitionStop")
    for selector in nodes.entries("TriggerSelector"):
        yield Write("TriggerSelector", selector)
        yield Write("TriggerMode", "Off")
    yield Write("AcquisitionMode", "Continuous")
    yield Write("ExposureMode", "Timed")
    yield Write("OffsetX", 0)
    yield Write("OffsetY", 0)
    yield Write("BinningHorizontal", 1)
    yield Write("BinningVertical", 1)
    yield Write("Width", HIGHEST)
    yield Write("Height", HIGHEST)
    yield Write("PixelFormat", pixel_format)
    yield Write("AcquisitionFrameRateEnable", False)
    yield Write("ExposureAuto", "Off")
    yield Write("GainAuto", "Off")
    yield Write("GammaEnable", False)
    yield Write("BlackLevel", setup.black_level)
    yield Write("AutoExposureExposureTimeUpperLimit", setup.exposure_us_max)
    yield Write("DeviceLinkThroughputLimit", setup.link_bytes_per_s)


def chunk_steps() -> Iterator[Step]:
    """Yield what makes every picture say how it was taken."""
    yield Write("ChunkModeActive", True)
    for chunk in CHUNKS:
        yield Write("ChunkSelector", chunk)
        yield Write("ChunkEnable", True)


def counter_steps(input_line: str | None) -> Iterator[Step]:
    """Yield what makes a camera count the edges on a line, and its exposures."""
    if input_line is not None:
        yield Write("CounterSelector", "Counter0")
        yield Write("CounterEventSource", input_line)
    yield Write("CounterSelector", "Counter1")
    yield Write("CounterEventSource", "ExposureStart")


def primary_steps() -> Iterator[Step]:
    """Yield what makes a camera wait for software and tell the other one when it exposes."""
    yield Write("LineSelector", "Line1")
    yield Write("LineMode", "Output", skip_if_locked=True)
    yield Write("LineInverter", False)
    yield Write("LineSource", "ExposureActive")
    yield Write("LineSelector", "Line2")
    yield Write("V3_3Enable", True)
    yield from software_trigger_steps()


def software_trigger_steps() -> Iterator[Step]:
    """Yield what makes a camera wait for software."""
    yield Write("TriggerSelector", "FrameStart")
    yield Write("TriggerSource", "Software")
    yield Write("TriggerOverlap", "Off")
    yield Write("TriggerMode", "On")


def secondary_steps() -> Iterator[Step]:
    """Yield what makes a camera expose with the edge from the other one."""
    yield Write("LineSelector", "Line2")
    yield Write("V3_3Enable", False)
    yield Write("LineSelector", "Line3")
    yield Write("LineMode", "Input", skip_if_locked=True)
    yield Write("TriggerSelector", "FrameStart")
    yield Write("TriggerSource", "Line3")
    yield Write("TriggerActivation", "RisingEdge")
    yield Write("TriggerDelay", LOWEST)
    yield Write("TriggerOverlap", "ReadOut")
    yield Write("TriggerMode", "On")


def free_run_steps(rate_hz: float) -> Iterator[Step]:
    """Yield what makes the primary expose on its own, `rate_hz` times a second."""
    yield Write("TriggerSelector", "FrameStart")
    yield Write("TriggerMode", "Off")
    yield Write("AcquisitionFrameRateEnable", True)
    yield Write("AcquisitionFrameRate", rate_hz)


def settings_steps(settings: Settings) -> Iterator[Step]:
    """Yield what fixes exposure time and gain."""
    yield Write("ExposureTime", settings.exposure_us)
    yield Write("Gain", settings.gain_db)


def manual_steps() -> Iterator[Step]:
    """Yield what ends the camera's own exposure control."""
    yield Write("ExposureAuto", "Off")
    yield Write("GainAuto", "Off")


def auto_steps(auto: Auto) -> Iterator[Step]:
    """Yield what makes the camera expose on its own, from `auto.start`, inside its limits."""
    yield from manual_steps()
    yield from settings_steps(auto.start)
    yield Write("AutoExposureTargetGreyValueAuto", "Off")
    yield Write("AutoExposureTargetGreyValue", percent(auto.target_dn))
    yield Write("AutoExposureControlLoopDamping", auto.damping)
    yield Write("AutoExposureControlPriority", PRIORITY_WORDS[auto.priority])
    yield Write("AutoExposureMeteringMode", METERING_WORDS[auto.metering])
    yield from _region_steps(auto.metering)
    yield from _limit_steps("AutoExposureExposureTime", auto.limits.exposure_us)
    yield from _limit_steps("AutoExposureGain", auto.limits.gain_db)
    yield Write("ExposureAuto", "Continuous")
    yield Write("GainAuto", "Continuous")


PRIORITY_WORDS: Mapping[Priority, str] = {"gain": "Gain", "exposure": "ExposureTime"}
"""Gain priority keeps gain lowest while exposure suffices; the other keeps exposure short."""

METERING_WORDS: Mapping[Metering, str] = {
    "average": "Average",
    "lower": "Average",
    "partial": "Partial",
    "spot": "Spot",
}
"""The lower part is an average over a region of interest."""


def _region_steps(metering: Metering) -> Iterator[Step]:
    """Yield what makes the camera meter all of the picture, or the lower part alone."""
    yield Write("AutoAlgorithmSelector", "Ae")
    if metering != "lower":
        yield Write("AasRoiEnable", False)
        return
    yield Write("AasRoiOffsetX", LOWEST)
    yield Write("AasRoiOffsetY", LOWEST)
    yield Write("AasRoiWidth", HIGHEST)
    yield Write("AasRoiHeight", LOWER)
    yield Write("AasRoiOffsetY", HIGHEST)
    yield Write("AasRoiEnable", True)


def metering_of(done: Mapping[str, Value | None], asked: Metering) -> Metering:
    """Return how a camera meters after `auto_steps`, by the nodes that it has."""
    needed = "AasRoiEnable" if asked == "lower" else "AutoExposureMeteringMode"
    return asked if needed in done else "average"


def percent(target_dn: float) -> float:
    """Return a mean grey of 0..255 as the camera counts it."""
    return target_dn * 100.0 / 255.0


def _limit_steps(name: str, ends: tuple[float, float]) -> Iterator[Step]:
    """Open a range before it is narrowed, so that no end passes the other."""
    yield Write(f"{name}LowerLimit", LOWEST)
    yield Write(f"{name}UpperLimit", ends[1])
    yield Write(f"{name}LowerLimit", ends[0])


@dataclass(frozen=True, slots=True)
class Done:
    """A step that was carried out: what was asked and what the camera says it is now."""

    node: str
    asked: Value | None
    now: Value | None


def carry_out(nodes: NodeMap, steps: Iterable[Step], kind: CameraType) -> list[Done]:
    """Carry out steps in order, each read back and logged.

    An optional node that is missing is passed over. Raises CameraError for a missing node that is
    needed, a write that the camera refuses, and a word that reads back as another one.
    """
    done = []
    for step in steps:
        name = kind.resolve(nodes, step.node)
        if name is None:
            _LOG.debug("%s: no %s, passed over", nodes.serial, step.node)
            continue
        done.append(_carry_out(nodes, step, name))
        if isinstance(step, Execute):
            _LOG.debug("%s: %s", nodes.serial, name)
        else:
            _LOG.debug("%s: %s = %s (asked %s)", nodes.serial, name, done[-1].now, done[-1].asked)
    return done


def _carry_out(nodes: NodeMap, step: Step, name: str) -> Done:
    if isinstance(step, Execute):
        nodes.execute(name)
        return Done(name, None, None)
    if step.skip_if_locked and not nodes.writable(name):
        return Done(name, step.value, nodes.read(name))
    value = _inside(nodes, name, step.value)
    nodes.write(name, value)
    now = nodes.read(name)
    if isinstance(value, bool | str) and now != value:
        raise CameraError(
            f"{nodes.serial}: {name} reads {now} after {value} was written; "
            "power the camera off and on, and check that nobody else uses it"
        )
    return Done(name, step.value, now)


def _inside(nodes: NodeMap, name: str, value: Value) -> Value:
    """Return a number inside the node's range; anything else as it is."""
    if isinstance(value, End):
        low, high = nodes.bounds(name)
        lower_part = int(LOWER_SHARE * high) // PIXEL_STEP * PIXEL_STEP
        return {LOWEST: low, HIGHEST: high, LOWER: lower_part}[value]
    if isinstance(value, bool | str):
        return value
    low, high = nodes.bounds(name)
    clamped = min(max(value, low), high)
    if clamped != value:
        _LOG.warning("%s: %s %g is clamped to %g", nodes.serial, name, value, clamped)
    return clamped


def read_limits(nodes: NodeMap, kind: CameraType) -> Limits:
    """Return what exposure times and gains the camera takes, as it says itself."""
    exposure = kind.resolve(nodes, "ExposureTime")
    gain = kind.resolve(nodes, "Gain")
    assert exposure is not None and gain is not None
    return Limits(nodes.bounds(exposure), nodes.bounds(gain))
