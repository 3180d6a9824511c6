"""The floor plan: four rooms beside `rig`, one importable name."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LINKED = ("drivers", "controllers", "calibration", "models")


@pytest.mark.parametrize("room", LINKED)
def test_room_is_a_relative_link(room: str) -> None:
    link = ROOT / "rig" / room
    assert link.is_symlink()
    assert str(link.readlink()) == f"../{room}"
    assert (link / "__init__.py").is_file()


@pytest.mark.heavy
def test_wheel_holds_one_name_and_every_network(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "build", "--wheel", "--outdir", str(tmp_path), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    top = {name.split("/")[0] for name in names if ".dist-info/" not in name}
    assert top == {"rig"}
    shipped = {path.name for path in (ROOT / "models" / "weights").glob("*.onnx")}
    packed = {Path(name).name for name in names if name.startswith("rig/models/weights/")}
    assert shipped and shipped <= packed
    assert "rig/drivers/sensor/models/blackfly-s-u3-31s4.toml" in names
