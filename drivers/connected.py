"""Which real cameras are connected: a quick look that needs no camera library.

USB3 Vision cameras stand in sysfs; GigE Vision cameras answer a broadcast.
"""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

SYSFS_USB = Path("/sys/bus/usb/devices")

ANSWER_WITHIN_S = 0.15
"""How long the cameras of a quiet network may take to answer."""

_USB3_VISION = ("ef", "05")
_GVCP_PORT = 3956
_DISCOVERY = struct.pack(">BBHHH", 0x42, 0x11, 0x0002, 0, 1)
_DISCOVERY_ANSWER = 0x0003
_HEADER_BYTES = 8
_IP_ADDRESS = slice(0x24, 0x28)
_MODEL, _SERIAL = slice(0x68, 0x88), slice(0xD8, 0xE8)
_ANSWER_BYTES = 0xF8


@dataclass(frozen=True, slots=True)
class Connected:
    """A camera that is there; `place` is its USB port or its network address."""

    serial: str
    model: str
    link: Literal["usb", "gige"]
    place: str = ""


def connected_cameras(usb: Path = SYSFS_USB) -> list[Connected]:
    """Return the real cameras on USB, below the sysfs folder `usb`, and on the network."""
    return [*usb_cameras(usb), *network_cameras()]


def usb_cameras(usb: Path = SYSFS_USB) -> Iterator[Connected]:
    """Yield the USB3 Vision cameras that the kernel knows."""
    for device in sorted(usb.glob("*")):
        interfaces = usb.glob(f"{device.name}:*")
        if ":" not in device.name and any(_is_camera(interface) for interface in interfaces):
            yield Connected(
                line_of(device / "serial"), line_of(device / "product"), "usb", device.name
            )


def network_cameras(wait_s: float = ANSWER_WITHIN_S) -> list[Connected]:
    """Return the GigE Vision cameras that answer; those of this computer itself are left out."""
    found: dict[str, Connected] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        with contextlib.suppress(OSError):
            asking.sendto(_DISCOVERY, ("255.255.255.255", _GVCP_PORT))
            until_s = time.monotonic() + wait_s
            while (left_s := until_s - time.monotonic()) > 0:
                asking.settimeout(left_s)
                address, camera = read_answer(asking.recv(1024))
                if camera is not None and not ipaddress.ip_address(address).is_loopback:
                    found[address] = camera
    return list(found.values())


def read_answer(packet: bytes) -> tuple[str, Connected | None]:
    """Return the address and the camera that a discovery answer tells; None when it is none."""
    if len(packet) < _HEADER_BYTES + _ANSWER_BYTES:
        return "", None
    status, code = struct.unpack_from(">HH", packet)
    if status or code != _DISCOVERY_ANSWER:
        return "", None
    told = packet[_HEADER_BYTES:]
    address = socket.inet_ntoa(told[_IP_ADDRESS])
    return address, Connected(_text(told[_SERIAL]), _text(told[_MODEL]), "gige", address)


def _is_camera(interface: Path) -> bool:
    kind = (line_of(interface / "bInterfaceClass"), line_of(interface / "bInterfaceSubClass"))
    return kind == _USB3_VISION


def line_of(file: Path) -> str:
    """Return what a file of the kernel says; empty where it cannot be read."""
    try:
        return file.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def _text(data: bytes) -> str:
    return data.split(b"\0")[0].decode(errors="replace")
