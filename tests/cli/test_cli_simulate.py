"""`rig simulate`: what a person looks at is what the camera would have given."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from rig.cli.main import run
from rig.core.types import Settings
from rig.drivers.registry import open_source
from rig.drivers.simulated.source import SimulatedSource, photographer
from rig.vision.bayer import to_bgr

WORLD = "sim:tunnel?size=320x240"


def read(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture


def test_pictures_and_a_contact_sheet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "looks"
    arguments = ["simulate", WORLD, "--exposure-us", "100,800", "--gain-db", "0,10", "--pair"]
    assert run([*arguments, "5,60", "--out", str(out), "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert len(values["pictures"]) == 8
    assert values["world_version"].startswith("tunnel/")
    files = {path.name for path in out.iterdir()}
    assert files == {each["file"] for each in values["pictures"]} | set(values["contact_sheets"])

    source = open_source(WORLD, seed=0)
    assert isinstance(source, SimulatedSource)
    mosaic = photographer(source.scene, "primary", source.drive)(60, Settings(800.0, 10.0))
    shown = next(
        each
        for each in values["pictures"]
        if (each["pair"], each["exposure_us"], each["gain_db"]) == (60, 800.0, 10.0)
    )
    assert np.array_equal(read(out / shown["file"]), to_bgr(mosaic, "bayer_rggb8"))
    assert shown["mean_dn"] == pytest.approx(float(mosaic.mean()))

    sheet = read(out / "contact-0060.png")
    assert sheet.shape[1] == 2 * 240
    middle = sheet.shape[0] // 2
    assert sheet[:middle, 240:].mean() > sheet[:middle, :240].mean()
    assert sheet[middle:].mean() > sheet[:middle].mean()


def test_a_folder_that_exists_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["simulate", "wall", "--out", str(tmp_path)]) == 1
    assert "nothing is overwritten" in capsys.readouterr().err
