"""Real cameras that are connected are found without a camera library, and asked about."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.cli.options import chosen_cameras
from rig.core.errors import RigError
from rig.drivers import connected
from rig.drivers.connected import Connected, network_cameras, read_answer, usb_cameras


def plug(root: Path, name: str, serial: str, interface: tuple[str, str] = ("ef", "05")) -> None:
    (root / name).mkdir()
    (root / name / "serial").write_text(f"{serial}\n")
    (root / name / "product").write_text("Blackfly S BFS-U3-31S4C\n")
    function = root / f"{name}:1.0"
    function.mkdir()
    (function / "bInterfaceClass").write_text(f"{interface[0]}\n")
    (function / "bInterfaceSubClass").write_text(f"{interface[1]}\n")


def test_usb3_vision_cameras_are_found_by_their_interface(tmp_path: Path) -> None:
    plug(tmp_path, "2-1", "01170163")
    plug(tmp_path, "2-2", "keyboard", interface=("03", "01"))
    plug(tmp_path, "2-3", "01170164")
    model = "Blackfly S BFS-U3-31S4C"
    assert list(usb_cameras(tmp_path)) == [
        Connected("01170163", model, "usb", "2-1"),
        Connected("01170164", model, "usb", "2-3"),
    ]


def test_no_usb_at_all_is_no_camera(tmp_path: Path) -> None:
    assert list(usb_cameras(tmp_path / "none")) == []


def test_simulated_cameras_of_this_computer_are_not_real() -> None:
    from served_pair import plane_plan, served

    with served(plane_plan()):
        assert network_cameras(wait_s=0.2) == []


def test_an_answer_is_read_and_noise_is_not() -> None:
    told = bytearray(0xF8)
    told[0x24:0x28] = bytes((192, 168, 1, 7))
    told[0x68:0x6C] = b"BFS\0"
    told[0xD8:0xE0] = b"20010001"
    packet = bytes((0, 0, 0, 3, 0, 0xF8, 0, 1)) + bytes(told)
    assert read_answer(packet) == (
        "192.168.1.7",
        Connected("20010001", "BFS", "gige", "192.168.1.7"),
    )
    assert read_answer(packet[:100])[1] is None
    assert read_answer(b"\x80\x01" + packet[2:])[1] is None


@pytest.mark.parametrize(
    ("serials", "address"),
    [
        (["18284899", "18284900"], "aravis:18284899,18284900"),
        (["18284899"], "aravis:18284899,SECONDARY"),
        (["1", "2", "3"], "aravis:1,2"),
    ],
)
def test_with_real_cameras_nobody_is_given_a_simulation(
    monkeypatch: pytest.MonkeyPatch, serials: list[str], address: str
) -> None:
    found = [Connected(serial, "Blackfly S", "usb") for serial in serials]
    monkeypatch.setattr(connected, "connected_cameras", lambda: found)
    with pytest.raises(RigError, match=f"pass --cameras {address} for them, or --cameras sim:tu"):
        chosen_cameras(None)
    assert chosen_cameras("sim:tunnel") == "sim:tunnel"


def test_without_real_cameras_the_simulation_is_meant(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connected, "connected_cameras", list)
    assert chosen_cameras(None) == "sim:tunnel"
