"""The exact node writes of research into the camera, in order, on a map of nodes that remembers."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace

import pytest

from rig.core.errors import CameraError
from rig.core.types import Auto, Limits, Settings
from rig.drivers import blackfly
from rig.drivers.blackfly import BLACKFLY_S, CameraType, Setup, Value, carry_out

BOUNDS: dict[str, tuple[float, float]] = {
    "ExposureTime": (11.0, 30e6),
    "Gain": (0.0, 47.99),
    "Width": (16, 2048),
    "Height": (16, 1536),
    "AasRoiOffsetX": (0, 0),
    "AasRoiOffsetY": (0, 464),
    "AasRoiWidth": (4, 2048),
    "AasRoiHeight": (4, 1536),
    "TriggerDelay": (8.0, 65_520.0),
    "AutoExposureExposureTimeUpperLimit": (11.0, 29_000.0),
    "AutoExposureTargetGreyValue": (4.0, 99.0),
}


@dataclass
class RememberingNodes:
    """Has every node but the `missing`; remembers what was written, in order."""

    serial: str = "18284899"
    missing: frozenset[str] = frozenset()
    locked: frozenset[str] = frozenset()
    deaf: frozenset[str] = frozenset()
    values: dict[str, Value] = field(default_factory=dict)
    written: list[str] = field(default_factory=list)

    def has(self, name: str) -> bool:
        return name not in self.missing

    def writable(self, name: str) -> bool:
        return name not in self.locked

    def read(self, name: str) -> Value:
        return self.values.get(name, "unknown")

    def write(self, name: str, value: Value) -> None:
        if name in self.locked:
            raise CameraError(f"{self.serial}: {name} is locked")
        self.written.append(f"{name}={value}")
        if name not in self.deaf:
            self.values[name] = value

    def execute(self, name: str) -> None:
        self.written.append(name)

    def bounds(self, name: str) -> tuple[float, float]:
        return BOUNDS.get(name, (0.0, 1e9))

    def entries(self, name: str) -> list[str]:
        return {"TriggerSelector": ["AcquisitionStart", "FrameStart", "FrameBurstStart"]}[name]


def written(nodes: RememberingNodes, steps: object, kind: CameraType = BLACKFLY_S) -> list[str]:
    carry_out(nodes, steps, kind)
    return nodes.written


def test_opening_stops_everything_and_fixes_every_setting_in_order() -> None:
    nodes = RememberingNodes()
    setup = Setup(exposure_us_max=30_000.0, link_bytes_per_s=190_000_000)
    assert written(nodes, blackfly.open_steps(nodes, setup, "BayerRG8")) == [
        "AcquisitionStop",
        "TriggerSelector=AcquisitionStart",
        "TriggerMode=Off",
        "TriggerSelector=FrameStart",
        "TriggerMode=Off",
        "TriggerSelector=FrameBurstStart",
        "TriggerMode=Off",
        "AcquisitionMode=Continuous",
        "ExposureMode=Timed",
        "OffsetX=0",
        "OffsetY=0",
        "BinningHorizontal=1",
        "BinningVertical=1",
        "Width=2048",
        "Height=1536",
        "PixelFormat=BayerRG8",
        "AcquisitionFrameRateEnable=False",
        "ExposureAuto=Off",
        "GainAuto=Off",
        "GammaEnable=False",
        "BlackLevel=0.0",
        "AutoExposureExposureTimeUpperLimit=29000.0",
        "DeviceLinkThroughputLimit=190000000",
    ]


def test_every_picture_carries_the_truth_about_itself() -> None:
    assert written(RememberingNodes(), blackfly.chunk_steps()) == [
        "ChunkModeActive=True",
        "ChunkSelector=FrameID",
        "ChunkEnable=True",
        "ChunkSelector=Timestamp",
        "ChunkEnable=True",
        "ChunkSelector=ExposureTime",
        "ChunkEnable=True",
        "ChunkSelector=Gain",
        "ChunkEnable=True",
    ]


def test_the_primary_tells_when_it_exposes_and_waits_for_software() -> None:
    assert written(RememberingNodes(), blackfly.primary_steps()) == [
        "LineSelector=Line1",
        "LineMode=Output",
        "LineInverter=False",
        "LineSource=ExposureActive",
        "LineSelector=Line2",
        "V3_3Enable=True",
        "TriggerSelector=FrameStart",
        "TriggerSource=Software",
        "TriggerOverlap=Off",
        "TriggerMode=On",
    ]


def test_the_secondary_exposes_with_the_edge_on_its_line() -> None:
    assert written(RememberingNodes(), blackfly.secondary_steps()) == [
        "LineSelector=Line2",
        "V3_3Enable=False",
        "LineSelector=Line3",
        "LineMode=Input",
        "TriggerSelector=FrameStart",
        "TriggerSource=Line3",
        "TriggerActivation=RisingEdge",
        "TriggerDelay=8.0",
        "TriggerOverlap=ReadOut",
        "TriggerMode=On",
    ]


def test_edges_and_exposures_are_counted() -> None:
    assert written(RememberingNodes(), blackfly.counter_steps("Line3")) == [
        "CounterSelector=Counter0",
        "CounterEventSource=Line3",
        "CounterSelector=Counter1",
        "CounterEventSource=ExposureStart",
    ]


def test_free_run_turns_the_trigger_off_before_the_rate_counts() -> None:
    assert written(RememberingNodes(), blackfly.free_run_steps(20.0)) == [
        "TriggerSelector=FrameStart",
        "TriggerMode=Off",
        "AcquisitionFrameRateEnable=True",
        "AcquisitionFrameRate=20.0",
    ]


def test_auto_sets_its_start_and_limits_before_it_begins() -> None:
    auto = Auto(Limits((75.0, 20_000.0), (0.0, 30.0)), 102.0, 0.25, Settings(900.0, 2.0))
    assert written(RememberingNodes(), blackfly.auto_steps(auto)) == [
        "ExposureAuto=Off",
        "GainAuto=Off",
        "ExposureTime=900.0",
        "Gain=2.0",
        "AutoExposureTargetGreyValueAuto=Off",
        "AutoExposureTargetGreyValue=40.0",
        "AutoExposureControlLoopDamping=0.25",
        "AutoExposureControlPriority=Gain",
        "AutoExposureMeteringMode=Average",
        "AutoAlgorithmSelector=Ae",
        "AasRoiEnable=False",
        "AutoExposureExposureTimeLowerLimit=0.0",
        "AutoExposureExposureTimeUpperLimit=20000.0",
        "AutoExposureExposureTimeLowerLimit=75.0",
        "AutoExposureGainLowerLimit=0.0",
        "AutoExposureGainUpperLimit=30.0",
        "AutoExposureGainLowerLimit=0.0",
        "ExposureAuto=Continuous",
        "GainAuto=Continuous",
    ]


def test_auto_meters_and_keeps_low_what_was_asked() -> None:
    nodes = RememberingNodes()
    steps = written(nodes, blackfly.auto_steps(Auto(metering="lower", priority="exposure")))
    first = steps.index("AutoExposureControlPriority=ExposureTime")
    assert steps[first + 1 : first + 9] == [
        "AutoExposureMeteringMode=Average",
        "AutoAlgorithmSelector=Ae",
        "AasRoiOffsetX=0",
        "AasRoiOffsetY=0",
        "AasRoiWidth=2048",
        "AasRoiHeight=1072",
        "AasRoiOffsetY=464",
        "AasRoiEnable=True",
    ]
    for metering in ("partial", "spot"):
        steps = written(RememberingNodes(), blackfly.auto_steps(Auto(metering=metering)))
        assert f"AutoExposureMeteringMode={metering.title()}" in steps
        assert "AasRoiEnable=False" in steps


def test_what_a_camera_cannot_meter_is_not_said_to_be_metered() -> None:
    without = RememberingNodes(missing=frozenset({"AasRoiEnable"}))
    auto = Auto(metering="lower")
    done = {
        step.node: step.now for step in carry_out(without, blackfly.auto_steps(auto), BLACKFLY_S)
    }
    assert blackfly.metering_of(done, "lower") == "average"
    assert blackfly.metering_of(done, "spot") == "spot"


def test_every_write_is_read_back_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    nodes = RememberingNodes()
    with caplog.at_level(logging.DEBUG):
        done = carry_out(nodes, blackfly.settings_steps(Settings(5.0, 60.0)), BLACKFLY_S)
    assert [(step.node, step.asked, step.now) for step in done] == [
        ("ExposureTime", 5.0, 11.0),
        ("Gain", 60.0, 47.99),
    ]
    assert "18284899: ExposureTime 5 is clamped to 11" in caplog.text
    assert "18284899: Gain = 47.99 (asked 60.0)" in caplog.text


def test_a_word_that_does_not_stick_is_an_error() -> None:
    nodes = RememberingNodes(deaf=frozenset({"TriggerSource"}), values={"TriggerSource": "Line0"})
    with pytest.raises(CameraError, match="18284899: TriggerSource reads Line0 after Line3 was"):
        carry_out(nodes, blackfly.secondary_steps(), BLACKFLY_S)


def test_a_locked_line_mode_is_left_as_it_is() -> None:
    nodes = RememberingNodes(locked=frozenset({"LineMode"}), values={"LineMode": "Output"})
    assert "LineMode=Output" not in written(nodes, blackfly.primary_steps())
    with pytest.raises(CameraError, match="TriggerMode is locked"):
        carry_out(
            RememberingNodes(locked=frozenset({"TriggerMode"})),
            blackfly.software_trigger_steps(),
            BLACKFLY_S,
        )


def test_an_optional_node_may_be_missing_and_a_needed_one_may_not() -> None:
    without = RememberingNodes(missing=frozenset({"V3_3Enable", "TriggerDelay", "TriggerOverlap"}))
    assert written(without, blackfly.secondary_steps()) == [
        "LineSelector=Line2",
        "LineSelector=Line3",
        "LineMode=Input",
        "TriggerSelector=FrameStart",
        "TriggerSource=Line3",
        "TriggerActivation=RisingEdge",
        "TriggerMode=On",
    ]
    nodes = RememberingNodes(missing=frozenset({"TriggerSource"}))
    with pytest.raises(CameraError, match="18284899: has no node TriggerSource, which a Blackfly"):
        carry_out(nodes, blackfly.secondary_steps(), BLACKFLY_S)


def test_another_name_for_a_node_is_data() -> None:
    nodes = RememberingNodes(missing=frozenset({"ExposureTime", "Gain"}))
    assert written(nodes, blackfly.settings_steps(Settings(500.0, 3.0))) == [
        "ExposureTimeAbs=500.0",
        "GainAbs=3.0",
    ]
    other = replace(BLACKFLY_S, name="other", aliases={"Gain": ("Amplification",)})
    nodes = RememberingNodes(missing=frozenset({"Gain"}))
    steps = blackfly.settings_steps(Settings(500.0, 3.0))
    assert written(nodes, steps, other) == ["ExposureTime=500.0", "Amplification=3.0"]


def test_limits_are_those_of_the_nodes() -> None:
    limits = blackfly.read_limits(RememberingNodes(), BLACKFLY_S)
    assert limits == Limits((11.0, 30e6), (0.0, 47.99))
