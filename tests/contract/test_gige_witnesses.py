"""Foreign witnesses: Aravis' own tools on our cameras, and our driver on Aravis' own fakes."""

from __future__ import annotations

import re
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest
from served_pair import needs_aravis, plane_plan, served

from rig.core.types import Lost, Pair, Settings
from rig.drivers.aravis.binding import library
from rig.drivers.aravis.probe import is_controlled
from rig.drivers.registry import open_source
from rig.drivers.simulated.gige.server import Server
from rig.pair import CameraPair

ARV_TOOL, ARV_CAMERA_TEST = "arv-tool-0.8", "arv-camera-test-0.8"
ARV_FAKE = "arv-fake-gv-camera-0.8"


def needs_tool(tool: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(shutil.which(tool) is None, reason=f"{tool} is not installed")


def run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def server() -> Iterator[Server]:
    with served(plane_plan()) as serving:
        yield serving


@needs_tool(ARV_TOOL)
def test_arv_tool_discovers_both_cameras(server: Server) -> None:
    found = run(ARV_TOOL)
    for serial, address in zip(("SIM-PRIMARY", "SIM-SECONDARY"), server.addresses, strict=True):
        assert re.search(rf"{serial} \({re.escape(address)}\)", found)


@needs_tool(ARV_TOOL)
def test_arv_tool_reads_and_writes_features(server: Server) -> None:
    said = run(
        ARV_TOOL,
        *("-a", server.addresses.primary, "control"),
        *("DeviceSerialNumber", "ExposureTime=1234.4", "Gain=6.04", "TriggerSelector=FrameStart"),
        *("TriggerSource=Line3", "LineSelector=Line1", "LineMode=Output", "PixelFormat"),
    )
    for line in (
        "DeviceSerialNumber = SIM-PRIMARY",
        "ExposureTime = 1234 us min:11 max:3e+07",
        "Gain = 6 dB min:0 max:47.99",
        "TriggerSource = Line3",
        "LineMode = Output",
        "PixelFormat = BayerRG8",
    ):
        assert line in said


@needs_tool(ARV_TOOL)
def test_arv_tool_lists_every_feature_we_drive(server: Server) -> None:
    said = run(ARV_TOOL, "-a", server.addresses.secondary, "features")
    for name in (
        *("ExposureTime", "Gain", "ExposureAuto", "GainAuto", "TriggerMode", "TriggerOverlap"),
        *("TriggerActivation", "TriggerDelay", "LineInverter", "V3_3Enable", "ChunkSelector"),
        *("CounterValue", "TransferQueueOverflowCount", "TimestampLatch", "DeviceSerialNumber"),
    ):
        assert f"'{name}'" in said


@needs_tool(ARV_CAMERA_TEST)
def test_arv_camera_test_streams_without_a_loss(server: Server) -> None:
    said = run(
        ARV_CAMERA_TEST,
        *("-n", server.addresses.primary, "--duration", "1", "-f", "25"),
        *("-u", "FrameID,Timestamp,ExposureTime,Gain", "--no-packet-socket"),
    )
    counts = {name: int(value) for name, value in re.findall(r"(n_\w+)\s*= (\d+)", said)}
    assert counts["n_completed_buffers"] >= 15
    for name in ("n_failures", "n_missing_packets", "n_error_packets", "n_size_mismatch_errors"):
        assert counts[name] == 0


@pytest.fixture
def fake_address() -> Iterator[str]:
    """Run Aravis' own GigE Vision fake; it listens at 127.0.0.1 only."""
    with subprocess.Popen(
        [ARV_FAKE, "-i", "127.0.0.1", "-s", "FAKE1"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as fake:
        assert _until(lambda: is_controlled("127.0.0.1") is not None), "the fake does not answer"
        yield "127.0.0.1"
        fake.terminate()


def _until(true: Callable[[], bool]) -> bool:
    """Return whether something comes true within the time that a busy machine may need."""
    end_s = time.monotonic() + 30.0
    while not (done := true()) and time.monotonic() < end_s:
        time.sleep(0.05)
    return done


NOT_SENT_AGAIN = {
    "primary: no frame",
    "primary: picture incomplete (packets missing)",
    "secondary: no frame",
}
"""What a busy machine may do to the fakes: they send no packet twice, and wait for no trigger."""


@needs_aravis
@needs_tool(ARV_FAKE)
def test_our_driver_drives_the_fakes_of_aravis(fake_address: str) -> None:
    library().enable_interface("Fake")
    try:
        source = open_source(f"aravis:{fake_address},1?mode=software&rate_hz=max", seed=0)
        with closing(source):
            pair, whole = CameraPair(source), 0
            while whole < 3:
                assert pair.triggers < 30, "the fakes lost nearly everything"
                whole += shows_what_was_asked(pair, pair.triggers)
    finally:
        library().disable_interface("Fake")


def shows_what_was_asked(pair: CameraPair, trigger: int) -> bool:
    """Take a pair with settings of its own and check every frame; return whether both came."""
    commands = Pair(Settings(9_000.0, trigger % 10), Settings(5_000.0, 2 * trigger % 10))
    assert pair.apply(commands) == commands
    shot = pair.shoot()
    for frame, command in zip(shot.frames, commands, strict=True):
        if isinstance(frame, Lost):
            assert frame.cause in NOT_SENT_AGAIN
            return False
        assert (frame.sequence, frame.used) == (trigger, command)
        assert frame.image.shape == (2048, 2048)
    return True
