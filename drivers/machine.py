"""What this computer offers cameras, as the kernel tells it, below any root."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rig.drivers.connected import line_of, usb_cameras

ROOT = Path("/")

USBFS_MB_NEEDED = 64
"""Below this two cameras on USB lose transfers: Aravis keeps up to 8 MB of each under way, and the
kernel's default is 16 MB for all."""

USBFS_MB_GOOD = 1000
"""What vendors recommend."""


@dataclass(frozen=True, slots=True)
class UsbDevice:
    """A USB3 Vision camera as it is plugged in.

    `speed_mbps` is the speed of the link, `controller` what it hangs on, `power_control` "on" or
    "auto", `node` the file by which programs reach it.
    """

    serial: str
    model: str
    port: str
    speed_mbps: float
    controller: str
    power_control: str
    node: Path

    @property
    def may_be_opened(self) -> bool:
        """Return whether this user may open it."""
        return os.access(self.node, os.R_OK | os.W_OK)


def usb_devices(root: Path = ROOT) -> Iterator[UsbDevice]:
    """Yield the USB3 Vision cameras of this computer."""
    folder = root / "sys/bus/usb/devices"
    for camera in usb_cameras(folder):
        device = folder / camera.place
        bus, number = (line_of(device / name) for name in ("busnum", "devnum"))
        yield UsbDevice(
            camera.serial,
            camera.model,
            camera.place,
            _number(line_of(device / "speed")) or 0.0,
            _controller(folder, bus),
            line_of(device / "power/control"),
            root / f"dev/bus/usb/{int(_number(bus) or 0):03d}/{int(_number(number) or 0):03d}",
        )


def usbfs_memory_mb(root: Path = ROOT) -> float | None:
    """Return how much memory USB transfers may take; None where there is no USB."""
    return _number(line_of(root / "sys/module/usbcore/parameters/usbfs_memory_mb"))


def socket_buffer_bytes(root: Path = ROOT) -> float | None:
    """Return the largest receive buffer that a program may ask for."""
    return _number(line_of(root / "proc/sys/net/core/rmem_max"))


def holders(node: Path, root: Path = ROOT) -> Iterator[str]:
    """Yield the programs that have a device open, as far as this user may see them."""
    for process in sorted((root / "proc").glob("[0-9]*")):
        try:
            files = [str(link.readlink()) for link in (process / "fd").iterdir()]
        except OSError:
            continue
        if str(node) in files:
            yield f"{line_of(process / 'comm')} (process {process.name})"


def _controller(folder: Path, bus: str) -> str:
    """Return the address of the controller behind a bus: USB 2 and 3 have one bus each on it."""
    hub = folder / f"usb{bus}"
    return hub.resolve().parent.name if hub.exists() else f"bus {bus}"


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None
