"""The doctor on computers that are not this one: every finding, and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import pytest
import usb.core

from rig.core.errors import CameraError, RigError
from rig.drivers.aravis.session import refuse_small_usb_memory
from rig.drivers.connected import Connected
from rig.drivers.doctor import udev
from rig.drivers.doctor.examination import Patient, examine
from rig.drivers.doctor.findings import Finding
from rig.drivers.doctor.usb import VENDOR_ID, seen_by_libusb
from rig.drivers.machine import usb_devices

ROOT = Path(__file__).resolve().parents[2]
MODEL = "Blackfly S BFS-U3-31S4C"


@dataclass
class Computer:
    """A computer below a folder, with cameras that are plugged in as a test says."""

    root: Path
    serials: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.write("proc/sys/net/core/rmem_max", "4194304")
        self.write("sys/module/usbcore/parameters/usbfs_memory_mb", "1000")
        (self.root / "sys/bus/usb/devices").mkdir(parents=True)

    def write(self, name: str, text: str) -> None:
        file = self.root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"{text}\n")

    def plug(
        self,
        serial: str,
        *,
        bus: int = 2,
        controller: str = "0000:00:14.0",
        speed: str = "5000",
        power: str = "on",
        writable: bool = True,
    ) -> None:
        number = len(self.serials) + 1
        self.serials.append(serial)
        devices = self.root / "sys/bus/usb/devices"
        hub = self.root / f"sys/devices/pci0000:00/{controller}/usb{bus}"
        hub.mkdir(parents=True, exist_ok=True)
        if not (devices / f"usb{bus}").exists():
            (devices / f"usb{bus}").symlink_to(hub)
        port = f"sys/bus/usb/devices/{bus}-{number}"
        for name, text in {
            "serial": serial,
            "product": MODEL,
            "speed": speed,
            "busnum": str(bus),
            "devnum": str(number),
            "power/control": power,
        }.items():
            self.write(f"{port}/{name}", text)
        self.write(f"{port}:1.0/bInterfaceClass", "ef")
        self.write(f"{port}:1.0/bInterfaceSubClass", "05")
        node = f"dev/bus/usb/{bus:03d}/{number:03d}"
        self.write(node, "")
        if not writable:
            (self.root / node).unlink()

    def examined(self, *, aravis: object = lambda: (0, 8, 30), network: object = list) -> dict:
        patient = Patient(self.root, aravis, lambda: self.serials, network)  # type: ignore[arg-type]
        return {finding.what: finding for finding in examine(patient)}


@pytest.fixture
def computer(tmp_path: Path) -> Computer:
    return Computer(tmp_path)


def only(found: dict[str, Finding], level: str) -> list[str]:
    return [finding.what for finding in found.values() if finding.level == level]


def test_a_computer_where_all_is_well_has_nothing_to_do(computer: Computer) -> None:
    computer.plug("01170163")
    computer.plug("01170164")
    found = computer.examined()
    assert only(found, "problem") == only(found, "warning") == []
    assert all(finding.fix == "" for finding in found.values())
    assert [device.controller for device in usb_devices(computer.root)] == ["0000:00:14.0"] * 2


def test_a_slow_link_is_a_problem(computer: Computer) -> None:
    computer.plug("01170163", speed="480")
    found = computer.examined()[f"{MODEL} 01170163 at USB 2-1: link"]
    assert (found.level, found.found) == ("problem", "480 Mbit/s, not USB 3")
    assert "USB 3 port" in found.fix


def test_a_camera_that_may_not_be_opened_is_a_problem(computer: Computer) -> None:
    computer.plug("01170163", writable=False)
    found = computer.examined()[f"{MODEL} 01170163 at USB 2-1: permission"]
    assert found.level == "problem"
    assert "--install-udev" in found.fix


def test_a_camera_that_may_fall_asleep_is_a_warning(computer: Computer) -> None:
    computer.plug("01170163", power="auto")
    found = computer.examined()[f"{MODEL} 01170163 at USB 2-1: power"]
    assert found.level == "warning"
    assert str(computer.root / "sys/bus/usb/devices/2-1/power/control") in found.fix


@pytest.mark.parametrize(
    ("memory_mb", "cameras", "level"),
    [(16, 2, "problem"), (16, 1, "warning"), (64, 2, "warning"), (1000, 2, "good"), (0, 2, "good")],
)
def test_memory_for_transfers(computer: Computer, memory_mb: int, cameras: int, level: str) -> None:
    computer.write("sys/module/usbcore/parameters/usbfs_memory_mb", str(memory_mb))
    for number in range(cameras):
        computer.plug(f"0117016{number}")
    found = computer.examined()["memory for USB transfers"]
    assert found.level == level
    assert ("usbfs_memory_mb=1000" in found.fix) is (level != "good")


def test_a_shared_controller_has_a_budget(computer: Computer) -> None:
    for number in range(3):
        computer.plug(f"0117016{number}")
    computer.plug("01170169", bus=4, controller="0000:05:00.0")
    found = computer.examined()
    assert found["USB controller 0000:05:00.0"].level == "good"
    crowded = found["USB controller 0000:00:14.0"]
    assert crowded.level == "warning"
    assert crowded.found.startswith("3 of the cameras, 519 MB/s at 55 Hz")
    assert crowded.fix.startswith("stay below 48 Hz")


def test_who_holds_a_camera_is_named(computer: Computer) -> None:
    computer.plug("01170163")
    computer.write("proc/4711/comm", "SpinView_QT")
    descriptors = computer.root / "proc/4711/fd"
    descriptors.mkdir()
    (descriptors / "7").symlink_to(computer.root / "dev/bus/usb/002/001")
    found = computer.examined()[f"{MODEL} 01170163 at USB 2-1: in use"]
    assert (found.level, found.found) == ("problem", "by SpinView_QT (process 4711)")


def test_an_old_aravis_is_a_hazard_on_usb_only(computer: Computer) -> None:
    assert computer.examined(aravis=lambda: (0, 8, 26))["Aravis"].level == "good"
    computer.plug("01170163")
    found = computer.examined(aravis=lambda: (0, 8, 26))["Aravis"]
    assert found.level == "warning"
    assert "install Aravis 0.8.29 or newer" in found.fix


def test_a_missing_aravis_is_a_problem(computer: Computer) -> None:
    def missing() -> tuple[int, int, int]:
        raise CameraError("real cameras need Aravis, which is not here; run apt-get install it")

    found = computer.examined(aravis=missing)["Aravis"]
    assert (found.level, found.fix) == ("problem", "run apt-get install it")


def test_network_cameras_need_a_receive_buffer(computer: Computer) -> None:
    computer.write("proc/sys/net/core/rmem_max", "212992")
    cameras = [Connected(str(n), "BFS-PGE", "gige", f"10.0.0.{n}") for n in (1, 2)]
    found = computer.examined(network=lambda: cameras)
    assert found["network cameras"].found == "BFS-PGE 1 at 10.0.0.1, BFS-PGE 2 at 10.0.0.2"
    buffer = found["receive buffer for network cameras"]
    assert buffer.level == "warning"
    assert buffer.fix.startswith("sudo sysctl -w net.core.rmem_max=4194304")
    assert "cameras" not in found


def test_no_cameras_is_said_and_breaks_nothing(tmp_path: Path) -> None:
    patient = Patient(tmp_path, lambda: (0, 8, 26), list, list)
    found = {finding.what: finding for finding in examine(patient)}
    assert only(found, "problem") == []
    assert found["cameras"].found == "0 found, a pair is two"
    assert found["USB cameras"].found == "none"


def test_a_camera_that_libusb_cannot_read_is_a_problem(computer: Computer) -> None:
    computer.plug("01170163")
    patient = Patient(computer.root, lambda: (0, 8, 30), list, list)
    found = {finding.what: finding for finding in examine(patient)}["libusb"]
    assert (found.level, found.found[:20]) == ("problem", "cannot read 01170163")


def test_libusb_is_asked_for_devices_of_flir(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def find(**wanted: object) -> list[object]:
        asked.append(wanted)
        return []

    monkeypatch.setattr(usb.core, "find", find)
    assert seen_by_libusb() == []
    assert asked == [{"find_all": True, "idVendor": VENDOR_ID}]

    def no_backend(**_: object) -> list[object]:
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb.core, "find", no_backend)
    with pytest.raises(OSError, match="libusb is not installed"):
        seen_by_libusb()


def test_the_rule_is_installed_and_is_the_one_in_tools(tmp_path: Path) -> None:
    file = udev.install(tmp_path)
    assert file == tmp_path / "etc/udev/rules.d/99-exposure-rig.rules"
    assert file.read_text() == (ROOT / "tools" / udev.NAME).read_text()


def test_a_rule_that_cannot_be_written_tells_how(tmp_path: Path) -> None:
    (tmp_path / "etc").write_text("a file where a folder must be")
    with pytest.raises(RigError, match=r"sudo \.venv/bin/rig doctor --install-udev"):
        udev.install(tmp_path)


def test_two_cameras_are_not_started_with_little_memory() -> None:
    with pytest.raises(CameraError, match=r"usbfs_memory_mb is 16: .* echo 1000"):
        refuse_small_usb_memory(2, 16.0)
    for cameras, memory_mb in ((1, 16.0), (2, 64.0), (2, 0.0), (2, None)):
        refuse_small_usb_memory(cameras, memory_mb)
