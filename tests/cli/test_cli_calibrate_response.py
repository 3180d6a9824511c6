"""`rig calibrate-response` on `sim:wall`: what was configured comes out, and can be simulated."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.cli.main import run
from rig.config import load_camera_model
from rig.drivers.sensor.sensor import electrons_per_cd_m2_s, response_table

MODELS = resources.files("rig") / "drivers/sensor/models"
BLACKFLY, BLUEFOX = "blackfly-s-u3-31s4", "mvbluefox3-2024a"


def calibrated(
    capsys: pytest.CaptureFixture[str], out: Path, camera: str, base: str, *more: str
) -> tuple[int, dict[str, Any]]:
    size = "968x608" if base == BLUEFOX else "640x480"
    capsys.readouterr()
    code = run(["calibrate-response", "--cameras", f"sim:wall?camera={camera}&size={size}",
                "--base", base, "--out", str(out), "--json", "-q", *more])  # fmt: skip
    return code, json.loads(capsys.readouterr().out)


def curved(folder: Path, base: str, response: str) -> str:
    """Return a file: the shipped model with another response."""
    head, _, tail = (MODELS / f"{base}.toml").read_text().partition("[response]")
    _, _, timing = tail.partition("[timing]")
    path = folder / "curved.toml"
    path.write_text(f"{head}[response]\n{response}\n\n[timing]{timing}")
    return str(path)


@pytest.mark.parametrize(
    ("base", "response"),
    [
        (BLACKFLY, ""),
        (BLUEFOX, ""),
        (BLACKFLY, 'curve = "gamma"\ngamma = 2.2'),
        pytest.param(BLUEFOX, 'curve = "srgb"', marks=pytest.mark.heavy),
    ],
)
def test_what_was_configured_is_recovered_within_3_percent(
    base: str, response: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = curved(tmp_path, base, response) if response else base
    true = load_camera_model(camera)
    luminance = ("--luminance-cd-m2", "100")
    code, values = calibrated(capsys, tmp_path / "twin", camera, base, *luminance)
    assert code == 0
    assert values["passed"] and values["residual"] <= values["tolerance"]
    for side in ("primary", "secondary"):
        told, found = values[side], load_camera_model(values[side]["file"])
        assert told["conversion_gain_e_per_dn"] == pytest.approx(true.converter.e_per_dn, rel=0.03)
        assert told["read_noise_e"] == pytest.approx(true.pixel.read_noise_e, rel=0.03)
        assert told["full_well_e"] == pytest.approx(true.pixel.full_well_e, rel=0.03)
        assert told["black_level_dn"] == pytest.approx(true.converter.black_level_dn, rel=0.03)
        ours, theirs = (response_table(m.response, 4096).astype(int) for m in (found, true))
        assert np.abs(ours - theirs).max() <= 2
        assert told["debevec_difference_dn"] < 2.0
        assert found.converter.e_per_dn == told["conversion_gain_e_per_dn"]
    twin = load_camera_model(values["file"])
    assert electrons_per_cd_m2_s(twin) == pytest.approx(electrons_per_cd_m2_s(true), rel=0.03)


def test_the_twin_is_simulated_and_measures_as_its_original(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, first = calibrated(capsys, tmp_path / "a", BLACKFLY, BLACKFLY)
    code, again = calibrated(capsys, tmp_path / "b", first["file"], BLACKFLY)
    assert code == 0
    for name in ("conversion_gain_e_per_dn", "read_noise_e", "full_well_e", "black_level_dn"):
        assert again["primary"][name] == pytest.approx(first["primary"][name], rel=0.02)
    assert (tmp_path / "b" / "response.svg").read_text().count("<polyline") == 2
    code = run(["collect", "--cameras", f"sim:tunnel?size=320x240&camera={first['file']}",
                "--frames", "3", "--out", str(tmp_path / "drive"), "-q"])  # fmt: skip
    assert code == 0


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--base", "blackfly-s-u3-31s"], 1, "did you mean blackfly-s-u3-31s4"),
        (["--base", BLUEFOX], 1, "has pictures of 1936x1216, these cameras of 640x480"),
        (["--luminance-cd-m2", "0"], 2, "--luminance-cd-m2 must be above 0"),
        (["--frames", "30"], 1, "cut short by --frames 30"),
        (["--cameras", "sim:chessboard?size=320x240"], 1, "uneven surface"),
    ],
)
def test_what_cannot_be_measured_is_said(
    arguments: list[str],
    code: int,
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "none"
    assert run(["calibrate-response", *arguments, "--out", str(out), "-q"]) == code
    assert words in capsys.readouterr().err
    assert not out.exists()
