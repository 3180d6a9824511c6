"""`rig devices`, `doctor`, `latency` and `dump-genicam`, without a camera."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from xml.etree import ElementTree

import pytest
from served_pair import needs_aravis, plane_plan, served

from rig.cli import latency as latency_command
from rig.cli.latency import by_mode
from rig.cli.main import run
from rig.drivers import connected
from rig.drivers.connected import Connected
from rig.drivers.doctor import examination, udev
from rig.drivers.doctor.findings import good, problem, warning

SMALL = "size=320x240"


def test_devices_are_listed_as_they_are_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = [
        Connected("01170163", "Blackfly S", "usb", "2-1"),
        Connected("20010001", "Blackfly S", "gige", "10.0.0.7"),
    ]
    monkeypatch.setattr(connected, "connected_cameras", lambda: found)
    assert run(["devices"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "01170163  Blackfly S  USB 2-1",
        "20010001  Blackfly S  10.0.0.7",
        "as a pair, the primary first: --cameras aravis:01170163,20010001",
    ]
    assert run(["devices", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["cameras"][1]["place"] == "10.0.0.7"


def test_no_devices_are_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(connected, "connected_cameras", list)
    assert run(["devices"]) == 0
    assert "no camera is connected" in capsys.readouterr().out


def test_the_doctor_fails_only_where_something_is_broken(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    findings = [good("link", "5000 Mbit/s"), warning("power", "may sleep", "keep it awake")]
    monkeypatch.setattr(examination, "examine", lambda: iter(findings))
    assert run(["doctor"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "ok       link: 5000 Mbit/s",
        "warning  power: may sleep",
        "         -> keep it awake",
    ]
    findings.append(problem("permission", "none", "install the rule"))
    assert run(["doctor", "--json"]) == 1
    told = json.loads(capsys.readouterr().out)["findings"]
    assert told[-1] == {
        "level": "problem",
        "what": "permission",
        "found": "none",
        "fix": "install the rule",
    }


def test_the_doctor_installs_the_rule_first(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(examination, "examine", lambda: iter([]))
    installed = []
    monkeypatch.setattr(udev, "install", lambda: installed.append(1) or tmp_path)
    assert run(["doctor", "--install-udev"]) == 0
    assert installed == [1]
    assert f"installed {tmp_path}" in capsys.readouterr().err


def test_the_doctor_runs_on_this_computer(capsys: pytest.CaptureFixture[str]) -> None:
    run(["doctor"])
    assert "receive buffer for network cameras" in capsys.readouterr().out


@pytest.mark.parametrize("frames", [0, 3])
def test_latency_says_what_the_simulation_has(
    capsys: pytest.CaptureFixture[str], frames: int
) -> None:
    address = f"sim:tunnel?{SMALL}&latency_frames={frames}"
    assert run(["latency", "--cameras", address, "--steps", "4", "--json"]) == 0
    modes = json.loads(capsys.readouterr().out)["modes"]
    assert list(modes) == ["next-frame"]
    for camera in modes["next-frame"].values():
        assert camera["frames_to_effect"] == {str(frames): 4}
        assert camera["without_effect"] == camera["disputed_by_brightness"] == 0


def test_latency_speaks(capsys: pytest.CaptureFixture[str]) -> None:
    address = f"sim:wall?{SMALL}&latency_frames=3"
    assert run(["latency", "--cameras", address, "--steps", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"SIMULATED: {address}"
    assert lines[1] == "next-frame, primary SIM-PRIMARY: settings come 3 frames late"
    assert lines[2].split() == ["3", "#" * 30, "2"]


@needs_aravis
def test_latency_is_measured_in_every_mode_through_aravis(
    capsys: pytest.CaptureFixture[str],
) -> None:
    address = f"gige:sim:wall?{SMALL}&latency_frames=1"
    assert run(["latency", "--cameras", address, "--steps", "2", "--json"]) == 0
    modes = json.loads(capsys.readouterr().out)["modes"]
    assert list(modes) == ["next-frame", "free-run"]
    assert modes["next-frame"]["primary"]["frames_to_effect"] == {"1": 2}
    assert sum(modes["free-run"]["secondary"]["frames_to_effect"].values()) == 2


def test_a_mode_that_is_named_is_the_only_one() -> None:
    assert list(by_mode("aravis:1,2?mode=software&rate_hz=5")) == [
        ("software", "aravis:1,2?rate_hz=5&mode=software")
    ]
    assert [mode for mode, _ in by_mode("aravis:1,2")] == ["next-frame", "free-run"]
    assert list(by_mode("sim:tunnel")) == [("next-frame", "sim:tunnel")]


def test_latency_tells_settings_without_effect(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    address = f"sim:wall?{SMALL}&latency_frames=400"
    assert run(["latency", "--cameras", address, "--steps", "2"]) == 1
    told = capsys.readouterr()
    assert "SIM-PRIMARY: 2 of 2 steps had no effect" in told.err
    assert latency_command.spelt({}) in told.out


def test_latency_needs_a_step(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["latency", "--steps", "0"]) == 2
    assert "--steps must be 1 or more, got 0" in capsys.readouterr().err


@needs_aravis
def test_a_camera_describes_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "camera.xml"
    with served(plane_plan()) as server:
        dump = ["dump-genicam", server.addresses.primary, "--out", str(file)]
        assert run(dump) == 0
        assert run(dump) == 1
    assert ElementTree.parse(file).getroot().tag.endswith("RegisterDescription")
    assert "ExposureTime" in file.read_text()
    told = capsys.readouterr()
    assert told.out.startswith("SIM-PRIMARY: ")
    assert "exists, nothing is overwritten" in told.err


@needs_aravis
def test_verbose_tells_every_value_that_is_written(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    collect = ["collect", "--perturb", "none", "--frames", "1", "--out", str(tmp_path / "run")]
    assert run([*collect, "-v", "--cameras", f"gige:sim:wall?{SMALL}"]) == 0
    assert "SIM-PRIMARY: LineSource = ExposureActive (asked ExposureActive)" in caplog.text
    monkeypatch.setattr(connected, "connected_cameras", list)
    assert run(["devices"]) == 0
    assert not logging.getLogger("rig.drivers").isEnabledFor(logging.DEBUG)
