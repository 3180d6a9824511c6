"""`rig calibrate-intrinsics` as it is called: live, from a recording, and with bad input."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rig.cli.main import run
from rig.config import load_calibration
from rig.core.types import SIDES, Frame
from rig.drivers.scenes.world import lens_for
from rig.record.reader import open_recording
from rig.vision.bayer import to_grey

DISTORTION = (-0.2, 0.05, 0.001, -0.0005, 0.0)
BOARD = "sim:chessboard?distortion=-0.2,0.05,0.001,-0.0005"


def called(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    capsys.readouterr()
    code = run(["calibrate-intrinsics", *map(str, arguments)])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def worst_corner_px(camera: dict[str, Any], width_px: int, height_px: int) -> float:
    """Return how far the picture's corners are undistorted to a wrong place."""
    lens = lens_for(width_px, height_px)
    true = np.array([[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1]])
    found = np.array(
        [[camera["fx_px"], 0, camera["cx_px"]], [0, camera["fy_px"], camera["cy_px"]], [0, 0, 1]]
    )
    ends = np.array([[[x, y]] for x in (0.0, width_px - 1) for y in (0.0, height_px - 1)])
    enough = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    a = cv2.undistortPoints(ends, true, np.array(DISTORTION), P=true, criteria=enough)
    told = np.array(camera["distortion"])
    b = cv2.undistortPoints(ends, found, told, P=true, criteria=enough)
    return float(np.linalg.norm(a - b, axis=2).max())


@pytest.mark.heavy
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_live_the_truth_is_recovered(
    seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "i"
    code, text, _ = called(capsys, "--cameras", BOARD, "--seed", seed, "--out", out, "--json", "-q")
    assert code == 0
    values = json.loads(text)
    assert values["passed"] and values["residual"] <= values["tolerance"]
    for side in SIDES:
        assert values[side]["fx_px"] == pytest.approx(lens_for(640, 480).fx_px, rel=0.003)
        assert worst_corner_px(values[side], 640, 480) < 0.3
    assert values["baseline_mm"] == pytest.approx(39.2, rel=0.01)
    assert values["sync"]["passed"]
    written = {path.name for path in out.iterdir()}
    assert written == {"calibration.toml", "primary.yaml", "secondary.yaml", "camchain.yaml",
                       "residuals.svg"}  # fmt: skip


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record the board in twelve poses."""
    folder = tmp_path_factory.mktemp("board") / "run"
    assert run(["collect", "--cameras", BOARD, "--perturb", "none", "--frames", "24",
                "--out", str(folder), "-q"]) == 0  # fmt: skip
    return folder


def test_a_recording_is_calibrated_and_completes_an_earlier_file(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, text, _ = called(
        capsys, recorded, "--lens", "HF6XA-5M", "--out", tmp_path / "i", "--json", "-q"
    )
    assert code == 0
    values = json.loads(text)
    assert values["views"] >= 8
    assert values["primary"]["fx_px"] == pytest.approx(lens_for(640, 480).fx_px, rel=0.01)
    found = load_calibration(Path(values["file"]))
    assert found.primary_serial == "SIM-PRIMARY"
    assert found.primary is not None and found.stereo is not None
    code = run(["calibrate-aperture", "--cameras", "sim:wall?size=320x240", "--auto", "-q",
                "--calibration", values["file"], "--out", str(tmp_path / "a")])  # fmt: skip
    assert code == 0
    both = load_calibration(tmp_path / "a" / "calibration.toml")
    assert both.aperture is not None and both.primary == found.primary
    assert both.lens == "HF6XA-5M"


def test_swapped_cameras_are_named(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = {"primary": tmp_path / "secondary", "secondary": tmp_path / "primary"}
    for folder in folders.values():
        folder.mkdir()
    for record in open_recording(recorded).records():
        for side, shot in zip(SIDES, record.shot, strict=True):
            assert isinstance(shot, Frame)
            grey = to_grey(shot.image, shot.pixel_format)
            cv2.imwrite(str(folders[side] / f"{record.trigger:03}.png"), grey)
    code, _, told = called(capsys, tmp_path, "--out", tmp_path / "i", "-q")
    assert code == 1
    assert "swapped cameras: the secondary is 39." in told
    assert "exchange the serials" in told


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--frames", "6"], "too few views: 3 good ones of at least 8"),
        (["--frames", "4", "--board", "7x5"], "wrong board: it has 9x6 inner corners, not 7x5"),
        (
            ["--frames", "2", "--cameras", "sim:wall?size=320x240"],
            "too few views: 0 good ones of at least 8",
        ),
    ],
)
def test_what_cannot_be_calibrated_is_said(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "none"
    code, _, told = called(capsys, *arguments, "--out", out, "-q")
    assert code == 1
    assert words in told
    assert not out.exists()
