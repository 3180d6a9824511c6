"""Calibrations and recordings: attached when recorded, checked when read, undistorted by."""

from __future__ import annotations

import datetime
import json
import os
from pathlib import Path

import pytest

from rig.calibration.files import write_calibration
from rig.cli.main import run
from rig.config import Calibration, LensCalibration
from rig.record.reader import open_recording

DISTORTION = (-0.25, 0.1, 0.0, 0.0, 0.0)
CAMERAS = "sim:tunnel?size=320x240&distortion=-0.25,0.1"


def calibration(
    date: datetime.date | None = None, fx_px: float = 282.2, swapped: bool = False
) -> Calibration:
    lens = LensCalibration(320, 240, fx_px, fx_px, 159.5, 119.5, DISTORTION, 0.1)
    serials = ("SIM-SECONDARY", "SIM-PRIMARY") if swapped else ("SIM-PRIMARY", "SIM-SECONDARY")
    day = date or datetime.datetime.now(datetime.UTC).date()
    return Calibration("rig.calibration/1", day, *serials, "HF6XA-5M", lens, lens)


def called(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    capsys.readouterr()
    code = run([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def collected(folder: Path, file: Path, cameras: str = CAMERAS) -> int:
    return run(["collect", "--cameras", cameras, "--frames", "14", "--calibration", str(file),
                "--out", str(folder)])  # fmt: skip


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("calibrated")
    write_calibration(folder / "calibration.toml", calibration())
    assert collected(folder / "drive", folder / "calibration.toml") == 0
    return folder / "drive"


def test_a_recording_carries_its_calibration(
    drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written = (drive.parent / "calibration.toml").read_text()
    assert open_recording(drive).header.calibration == written
    code, out, _ = called(capsys, "info", drive, "--json")
    assert code == 0
    told = json.loads(out)["calibration"]
    assert (told["lens"], told["warnings"]) == ("HF6XA-5M", [])
    assert told["parts"] == ["primary", "secondary"]


def test_the_calibration_of_the_current_folder_is_attached_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_calibration(tmp_path / "calibration.toml", calibration())
    code, _, _ = called(capsys, "collect", "--cameras", CAMERAS, "--frames", 2, "--out", "a", "-q")
    assert code == 0
    assert open_recording(tmp_path / "a").header.calibration
    write_calibration(tmp_path / "calibration.toml", calibration(swapped=True))
    code, _, told = called(capsys, "collect", "--cameras", CAMERAS, "--frames", 2, "--out", "b")
    assert code == 0
    assert "not attached: calibration.toml: swapped cameras" in told
    assert not open_recording(tmp_path / "b").header.calibration


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (calibration(swapped=True), "swapped cameras: it has SIM-SECONDARY as primary"),
        (calibration(fx_px=200.0), "calibrated with another lens; calibrate again"),
        (calibration(datetime.date(2999, 1, 1)), "is dated 2999-01-01, after the pictures"),
    ],
)
def test_a_named_calibration_of_other_cameras_is_refused(
    made: Calibration, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_calibration(tmp_path / "c.toml", made)
    assert collected(tmp_path / "drive", tmp_path / "c.toml") == 1
    assert words in capsys.readouterr().err
    assert not (tmp_path / "drive").exists()


def test_an_old_calibration_is_attached_with_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_calibration(tmp_path / "c.toml", calibration(datetime.date(2020, 1, 1)))
    assert collected(tmp_path / "drive", tmp_path / "c.toml") == 0
    assert "days old (2020-01-01); calibrate again" in capsys.readouterr().err
    code, _, told = called(capsys, "evaluate", tmp_path / "drive", "--front-end", "orb", "--json")
    assert code == 0
    assert "warning: " in told and "days old (2020-01-01); calibrate again" in told


def test_evaluation_undistorts_when_asked(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = called(capsys, "evaluate", drive, "--front-end", "orb", "--json")
    flat = called(capsys, "evaluate", drive, "--front-end", "orb", "--json", "--undistort")
    assert plain[0] == flat[0] == 0
    before, after = (json.loads(out)["runs"][0]["left"]["orb"] for _, out, _ in (plain, flat))
    assert before != after
    assert after["min"] > 20


def test_a_calibration_from_after_the_recording_is_told_on_load(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "run.mcap"
    copy.write_bytes((drive / "run.mcap").read_bytes())
    os.utime(copy, (0, 0))
    code, _, told = called(capsys, "evaluate", copy, "--front-end", "orb", "--undistort")
    assert code == 1
    assert "after the pictures of 1970-01-01" in told
    _, out, _ = called(capsys, "info", copy, "--json")
    assert "after the pictures" in json.loads(out)["calibration"]["warnings"][0]


def test_nothing_to_undistort_by_is_said(
    race_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, told = called(capsys, "evaluate", race_folder, "--undistort")
    assert code == 1
    assert "no calibration is attached" in told
    code, _, told = called(capsys, "evaluate", tmp_path, "--undistort")
    assert code == 2
    assert "carries no calibration; leave it out" in told
