"""Camera-model files: the shipped one, and the ways in which one can be wrong."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest

from rig.config import TableResponse, load_camera_model
from rig.core.errors import ConfigError

SHIPPED = resources.files("rig") / "drivers/sensor/models/blackfly-s-u3-31s4.toml"


def write(folder: Path, *, old: str = "", new: str = "") -> str:
    text = SHIPPED.read_text()
    assert old in text
    path = folder / "camera.toml"
    path.write_text(text.replace(old, new, 1))
    return str(path)


def test_the_shipped_model_is_the_blackfly() -> None:
    model = load_camera_model("blackfly-s-u3-31s4")
    assert (model.picture.width_px, model.picture.height_px) == (2048, 1536)
    assert model.controls.limits.exposure_us == (11.0, 30e6)
    assert model.controls.limits.gain_db == (0.0, 47.99)
    assert model.picture.format == "bayer_rggb8"


def test_a_model_is_read_from_a_file(tmp_path: Path) -> None:
    path = write(tmp_path, old='curve = "linear"', new='curve = "table"\ntable = [0, 0.7, 1]')
    assert load_camera_model(path).response == TableResponse(table=(0.0, 0.7, 1.0))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("read_noise_e = 2.4", "read_noise_e = -1", "pixel.read_noise_e: Expected `float` >= 0"),
        ("read_noise_e = 2.4", 'read_noise_e = "low"', "pixel.read_noise_e: Expected"),
        ("dsnu_e = 0.5", "dsnu_e = 0.5\nnoise = 1", "pixel: .*unknown field `noise`"),
        ("[lens]", "[lense]", "top level: .*unknown field `lense`"),
        ("f_number = 8.0", "", "lens: .*missing required field `f_number`"),
        ("gain_db = [0.0, 47.99]", "gain_db = [9.0, 4.0]", "controls: gain_db must go from low"),
        ('curve = "linear"', 'curve = "loglog"', "response.curve: .*loglog"),
        ('curve = "linear"', 'curve = "linear"\ngamma = 2.0', "response: .*unknown field `gamma`"),
        ('curve = "linear"', 'curve = "table"\ntable = [0.0, 0.7, 0.3]', "response: table must"),
        ("[lens]", "[lens", "not valid TOML"),
    ],
)
def test_a_wrong_file_is_refused_by_file_and_field(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = write(tmp_path, old=old, new=new)
    with pytest.raises(ConfigError, match=message) as caught:
        load_camera_model(path)
    assert str(caught.value).startswith(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "absent.toml"
    with pytest.raises(ConfigError, match=r"absent\.toml: cannot be read"):
        load_camera_model(str(path))


def test_a_misspelt_name_gets_a_hint() -> None:
    with pytest.raises(ConfigError, match="did you mean blackfly-s-u3-31s4"):
        load_camera_model("blackfly-s-u3-31s")
