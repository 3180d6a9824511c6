"""The features of the simulated camera: names as on a Blackfly S, one register each.

The names, ranges and enumerations are those of the vendor's feature reference; the addresses and
the description that a client downloads are our own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from rig.config import CameraModel

Kind = Literal["integer", "float", "boolean", "enumeration", "command", "string"]
Access = Literal["RO", "RW", "WO"]

FIRST_ADDRESS = 0x10000
"""Where the features begin; below are the registers that GigE Vision itself defines."""

_SLOT_BYTES = 8

BAYER_RG8 = 0x01080009
MONO8 = 0x01080001
CHUNKS = {"Image": 1, "FrameID": 2, "ExposureTime": 3, "Gain": 4, "Timestamp": 5}
"""The parts that can follow a picture, and the number that marks each."""


@dataclass(frozen=True, slots=True)
class Feature:
    """One feature: `low`..`high` bound numbers, `entries` are the words of an enumeration.

    A feature with a `selector` has one register for each entry of that enumeration. `value` is
    what it wakes up with. A `locked` feature cannot be written while pictures are taken.
    """

    name: str
    category: str
    kind: Kind
    value: float | str = 0
    access: Access = "RW"
    low: float | None = None
    high: float | None = None
    step: int | None = None
    entries: tuple[tuple[str, int], ...] = ()
    selector: str = ""
    locked: bool = False
    unit: str = ""
    length: int = 4
    address: int = -1


@dataclass(frozen=True, slots=True)
class FeatureTable:
    """All features with their addresses; the `hidden` ones are not told to clients."""

    features: tuple[Feature, ...]
    hidden: frozenset[str] = frozenset()
    by_name: dict[str, Feature] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.by_name.update({feature.name: feature for feature in self.features})

    def __getitem__(self, name: str) -> Feature:
        return self.by_name[name]

    def __contains__(self, name: object) -> bool:
        return name in self.by_name

    @property
    def told(self) -> tuple[Feature, ...]:
        """Return the features that a client hears of."""
        return tuple(f for f in self.features if f.name not in self.hidden)

    def copies(self, feature: Feature) -> int:
        """Return how many registers a feature has."""
        return len(self[feature.selector].entries) if feature.selector else 1

    def selected_by(self, selector: str) -> tuple[str, ...]:
        """Return the features that an enumeration selects."""
        return tuple(f.name for f in self.told if f.selector == selector)


def make_table(
    model: CameraModel, serial: str, width_px: int, height_px: int, hidden: Iterable[str] = ()
) -> FeatureTable:
    """Return the features of a camera of `model` with a sensor of the given size."""
    features = _features(model, serial, width_px, height_px)
    return FeatureTable(tuple(_placed(features)), frozenset(hidden))


def words(*names: str) -> tuple[tuple[str, int], ...]:
    """Return the entries of an enumeration that counts from 0."""
    return tuple((name, number) for number, name in enumerate(names))


_SELECTORS = {
    "TriggerSelector": words("AcquisitionStart", "FrameStart", "FrameBurstStart"),
    "LineSelector": words("Line0", "Line1", "Line2", "Line3"),
    "ChunkSelector": tuple((name, number) for number, name in enumerate(CHUNKS)),
    "CounterSelector": words("Counter0", "Counter1"),
}


def _placed(features: Iterable[Feature]) -> Iterator[Feature]:
    """Give each feature the next free address."""
    address = FIRST_ADDRESS
    for feature in features:
        yield replace(feature, address=address)
        copies = len(_SELECTORS[feature.selector]) if feature.selector else 1
        address += register_stride(feature) * copies


def register_stride(feature: Feature) -> int:
    """Return how many bytes lie between the registers of a selected feature."""
    return -(-feature.length // _SLOT_BYTES) * _SLOT_BYTES


def _features(
    model: CameraModel, serial: str, width_px: int, height_px: int
) -> tuple[Feature, ...]:
    return (
        *_device(model, serial),
        *_image_format(model, width_px, height_px),
        *_acquisition(model),
        *_trigger(),
        *_analog(model),
        *_auto(model, width_px, height_px),
        *_lines(),
        *_counters(),
        *_chunks(),
        *_transport(),
    )


def _text(name: str, category: str, value: str) -> Feature:
    return Feature(name, category, "string", value, "RO", length=32)


def _int(name: str, category: str, value: int, **more: Any) -> Feature:
    return Feature(name, category, "integer", value, **more)


def _float(name: str, category: str, value: float, low: float, high: float, **more: Any) -> Feature:
    return Feature(name, category, "float", value, low=low, high=high, length=8, **more)


def _bool(name: str, category: str, value: bool = False, **more: Any) -> Feature:
    return Feature(name, category, "boolean", int(value), **more)


def _enum(
    name: str, category: str, entries: tuple[tuple[str, int], ...], value: str, **more: Any
) -> Feature:
    number = dict(entries)[value]
    return Feature(name, category, "enumeration", number, entries=entries, **more)


def _selector(name: str, category: str, value: str) -> Feature:
    return _enum(name, category, _SELECTORS[name], value)


def _command(name: str, category: str) -> Feature:
    return Feature(name, category, "command", access="WO")


def _device(model: CameraModel, serial: str) -> tuple[Feature, ...]:
    room = "DeviceControl"
    return (
        _text("DeviceVendorName", room, VENDOR),
        _text("DeviceModelName", room, model.name),
        _text("DeviceVersion", room, "simulated"),
        _text("DeviceSerialNumber", room, serial),
        _int("DeviceLinkThroughputLimit", room, 380_000_000, low=1_000_000, high=500_000_000),
        _float("DeviceTemperature", room, 45.0, -50.0, 125.0, access="RO", unit="C"),
        _command("TimestampLatch", room),
        _int("TimestampLatchValue", room, 0, access="RO", length=8),
        _int("LinkErrorCount", room, 0, access="RO", length=8),
    )


VENDOR = "exposure-rig"


def _image_format(model: CameraModel, width_px: int, height_px: int) -> tuple[Feature, ...]:
    room = "ImageFormatControl"
    pixels = {"bayer_rggb8": ("BayerRG8", BAYER_RG8), "mono8": ("Mono8", MONO8)}
    pixel = pixels[model.picture.format]
    width = {"high": width_px, "access": "RO"}
    height = {"high": height_px, "access": "RO"}
    return (
        _int("SensorWidth", room, width_px, **width),
        _int("SensorHeight", room, height_px, **height),
        _int("WidthMax", room, width_px, **width),
        _int("HeightMax", room, height_px, **height),
        _int("Width", room, width_px, low=width_px, high=width_px, step=2, locked=True),
        _int("Height", room, height_px, low=height_px, high=height_px, step=2, locked=True),
        _int("OffsetX", room, 0, low=0, high=0, locked=True),
        _int("OffsetY", room, 0, low=0, high=0, locked=True),
        _int("BinningHorizontal", room, 1, low=1, high=1, locked=True),
        _int("BinningVertical", room, 1, low=1, high=1, locked=True),
        _enum("PixelFormat", room, (pixel,), pixel[0], locked=True),
    )


def _acquisition(model: CameraModel) -> tuple[Feature, ...]:
    room = "AcquisitionControl"
    low, high = model.controls.exposure_us
    fastest_hz = 1.0 / model.timing.readout_s if model.timing.readout_s else 1000.0
    off_once_continuous = words("Off", "Once", "Continuous")
    modes = words("Continuous", "SingleFrame", "MultiFrame")
    return (
        _enum("AcquisitionMode", room, modes, "Continuous", locked=True),
        _command("AcquisitionStart", room),
        _command("AcquisitionStop", room),
        _bool("AcquisitionFrameRateEnable", room),
        _float("AcquisitionFrameRate", room, fastest_hz, 1.0, fastest_hz, unit="Hz"),
        _float("AcquisitionResultingFrameRate", room, fastest_hz, 0.0, 1e4, access="RO", unit="Hz"),
        _enum("ExposureMode", room, words("Timed", "TriggerWidth"), "Timed"),
        _enum("ExposureAuto", room, off_once_continuous, "Off"),
        _float("ExposureTime", room, model.controls.initial_exposure_us, low, high, unit="us"),
    )


def _trigger() -> tuple[Feature, ...]:
    room = "AcquisitionControl"
    by: dict[str, Any] = {"selector": "TriggerSelector"}
    sources = words("Software", "Line0", "Line1", "Line2", "Line3", "Counter0Start")
    edges = words("FallingEdge", "RisingEdge", "AnyEdge")
    return (
        _selector("TriggerSelector", room, "FrameStart"),
        _enum("TriggerMode", room, words("Off", "On"), "Off", **by),
        _enum("TriggerSource", room, sources, "Software", **by),
        _enum("TriggerActivation", room, edges, "RisingEdge", **by),
        _enum("TriggerOverlap", room, words("Off", "ReadOut", "PreviousFrame"), "Off", **by),
        _float("TriggerDelay", room, TRIGGER_DELAY_US, TRIGGER_DELAY_US, 65_520.0, unit="us"),
        _command("TriggerSoftware", room),
    )


TRIGGER_DELAY_US = 8.0
"""The shortest delay between an edge and the exposure that it starts."""


def _analog(model: CameraModel) -> tuple[Feature, ...]:
    room = "AnalogControl"
    low, high = model.controls.gain_db
    auto = words("Off", "Once", "Continuous")
    return (
        _enum("GainAuto", room, auto, "Off"),
        _float("Gain", room, model.controls.initial_gain_db, low, high, unit="dB"),
        _float("BlackLevel", room, 0.0, 0.0, 10.0, unit="%"),
        _bool("GammaEnable", room),
        _float("Gamma", room, 1.0, 0.25, 4.0),
        _enum("BalanceWhiteAuto", room, auto, "Off"),
    )


def _auto(model: CameraModel, width_px: int, height_px: int) -> tuple[Feature, ...]:
    room = "AutoAlgorithmControl"
    exposure, gain = model.controls.exposure_us, model.controls.gain_db
    low_us, high_us = "AutoExposureExposureTimeLowerLimit", "AutoExposureExposureTimeUpperLimit"
    return (
        _enum("AutoExposureTargetGreyValueAuto", room, words("Off", "Continuous"), "Off"),
        _float("AutoExposureTargetGreyValue", room, 43.0, 0.1, 100.0, unit="%"),
        _float("AutoExposureControlLoopDamping", room, 0.5, 0.0, 0.999),
        _enum("AutoExposureControlPriority", room, words("Gain", "ExposureTime"), "Gain"),
        _enum("AutoExposureMeteringMode", room, words("Average", "Spot", "Partial"), "Average"),
        _enum("AutoAlgorithmSelector", room, words("Awb", "Ae"), "Ae"),
        _bool("AasRoiEnable", room),
        _int("AasRoiOffsetX", room, 0, low=0, high=0),
        _int("AasRoiOffsetY", room, 0, low=0, high=height_px * 3 // 10),
        _int("AasRoiWidth", room, width_px, low=width_px, high=width_px),
        _int("AasRoiHeight", room, height_px, low=4, high=height_px),
        _float(low_us, room, exposure[0], *exposure, unit="us"),
        _float(high_us, room, exposure[1], *exposure, unit="us"),
        _float("AutoExposureGainLowerLimit", room, gain[0], *gain, unit="dB"),
        _float("AutoExposureGainUpperLimit", room, gain[1], *gain, unit="dB"),
    )


def _lines() -> tuple[Feature, ...]:
    room = "DigitalIOControl"
    by: dict[str, Any] = {"selector": "LineSelector"}
    sources = words("Off", "ExposureActive", "UserOutput0", "Counter0Active")
    return (
        _selector("LineSelector", room, "Line0"),
        _enum("LineMode", room, words("Input", "Output"), "Input", **by),
        _enum("LineSource", room, sources, "Off", **by),
        _bool("LineInverter", room, **by),
        _bool("V3_3Enable", room, **by),
    )


def _counters() -> tuple[Feature, ...]:
    room = "CounterAndTimerControl"
    by: dict[str, Any] = {"selector": "CounterSelector"}
    events = words("Off", "MHzTick", "Line0", "Line1", "Line2", "Line3", "ExposureStart")
    return (
        _selector("CounterSelector", room, "Counter0"),
        _enum("CounterEventSource", room, events, "Off", **by),
        _int("CounterValue", room, 0, access="RO", **by),
    )


def _chunks() -> tuple[Feature, ...]:
    room = "ChunkDataControl"
    return (
        _bool("ChunkModeActive", room, locked=True),
        _selector("ChunkSelector", room, "Image"),
        _bool("ChunkEnable", room, selector="ChunkSelector", locked=True),
    )


def _transport() -> tuple[Feature, ...]:
    room = "TransportLayerControl"
    return (
        _int("PayloadSize", room, 0, access="RO"),
        _int("TransferQueueOverflowCount", room, 0, access="RO", length=8),
    )
