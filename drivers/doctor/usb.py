"""USB3 Vision: speed, permission, power, memory for transfers, and who shares a controller."""

from __future__ import annotations

import contextlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from rig.drivers.doctor.findings import Finding, good, problem, warning
from rig.drivers.machine import (
    ROOT,
    USBFS_MB_GOOD,
    USBFS_MB_NEEDED,
    UsbDevice,
    holders,
    usb_devices,
    usbfs_memory_mb,
)

VENDOR_ID = 0x1E10
"""FLIR, before that Point Grey."""

_SUPER_SPEED_MBPS = 5_000.0
_CONTROLLER_BYTES_PER_S = 450e6
"""What one controller carries, as FLIR says; of 5 Gbit/s the rest is encoding and protocol."""
_PICTURE_BYTES = 2048 * 1536
_FASTEST_HZ = 55.0

SeenByLibusb = Callable[[], list[str]]
"""Returns the serial numbers of FLIR's devices that libusb can open; raises OSError without it."""


def examine(root: Path = ROOT, seen: SeenByLibusb | None = None) -> Iterator[Finding]:
    """Yield what stands between this computer and cameras on USB."""
    cameras = list(usb_devices(root))
    if not cameras:
        yield good("USB cameras", "none")
        return
    for camera in cameras:
        yield _speed(camera)
        yield _permission(camera)
        yield _power(camera, root)
        yield from _holder(camera, root)
    yield _memory(len(cameras), usbfs_memory_mb(root))
    yield from _controllers(cameras)
    yield from _libusb(cameras, seen or seen_by_libusb)


def seen_by_libusb() -> list[str]:
    """Ask libusb itself, by reading the serial number of each device of FLIR."""
    import usb.core
    import usb.util

    serials = []
    try:
        for device in usb.core.find(find_all=True, idVendor=VENDOR_ID):
            # pyusb says in one of these ways that a device may not be read: it counts as unseen.
            with contextlib.suppress(usb.core.USBError, ValueError, NotImplementedError):
                serials.append(str(usb.util.get_string(device, device.iSerialNumber)))
    except usb.core.NoBackendError as error:
        raise OSError("libusb is not installed") from error
    return serials


def _named(camera: UsbDevice) -> str:
    return f"{camera.model} {camera.serial} at USB {camera.port}"


def _speed(camera: UsbDevice) -> Finding:
    what, found = f"{_named(camera)}: link", f"{camera.speed_mbps:g} Mbit/s"
    if camera.speed_mbps >= _SUPER_SPEED_MBPS:
        return good(what, found)
    return problem(
        what,
        f"{found}, not USB 3",
        "plug it into a USB 3 port (blue, or marked SS) with a USB 3 cable under 5 m, no USB 2 hub",
    )


def _permission(camera: UsbDevice) -> Finding:
    what = f"{_named(camera)}: permission"
    if camera.may_be_opened:
        return good(what, f"{camera.node} may be written")
    return problem(
        what,
        f"{camera.node} may not be written by this user, so libraries do not even list it",
        "sudo .venv/bin/rig doctor --install-udev, then plug the camera out and in",
    )


def _power(camera: UsbDevice, root: Path) -> Finding:
    what = f"{_named(camera)}: power"
    if camera.power_control != "auto":
        return good(what, "stays awake")
    control = root / "sys/bus/usb/devices" / camera.port / "power/control"
    return warning(
        what,
        "the kernel may put it to sleep (power/control is auto)",
        f"echo on | sudo tee {control}; for good: rig doctor --install-udev",
    )


def _holder(camera: UsbDevice, root: Path) -> Iterator[Finding]:
    programs = ", ".join(holders(camera.node, root))
    if programs:
        yield problem(f"{_named(camera)}: in use", f"by {programs}", "end that program")


def _memory(cameras: int, memory_mb: float | None) -> Finding:
    what = "memory for USB transfers"
    if memory_mb is None:
        return warning(what, "the kernel does not tell usbfs_memory_mb", "check that usbcore runs")
    found = f"usbfs_memory_mb is {memory_mb:g}"
    fix = (
        f"echo {USBFS_MB_GOOD} | sudo tee /sys/module/usbcore/parameters/usbfs_memory_mb; "
        f"for good: add usbcore.usbfs_memory_mb={USBFS_MB_GOOD} to the kernel's command line"
    )
    if memory_mb == 0 or memory_mb >= USBFS_MB_GOOD:
        return good(what, found)
    if cameras > 1 and memory_mb < USBFS_MB_NEEDED:
        return problem(what, f"{found}: two cameras lose transfers, with error -11", fix)
    return warning(what, f"{found}, {USBFS_MB_GOOD} is recommended", fix)


def _controllers(cameras: Iterable[UsbDevice]) -> Iterator[Finding]:
    """Compare what the cameras of each controller send at most with what it carries."""
    shared: dict[str, list[UsbDevice]] = defaultdict(list)
    for camera in cameras:
        shared[camera.controller].append(camera)
    for controller, members in shared.items():
        yield _budget(controller, members)


def _budget(controller: str, members: Sequence[UsbDevice]) -> Finding:
    what = f"USB controller {controller}"
    most = len(members) * _PICTURE_BYTES * _FASTEST_HZ
    found = (
        f"{len(members)} of the cameras, {most / 1e6:.0f} MB/s at {_FASTEST_HZ:g} Hz and full size "
        f"of {_CONTROLLER_BYTES_PER_S / 1e6:.0f} MB/s"
    )
    if most <= _CONTROLLER_BYTES_PER_S:
        return good(what, found)
    rate_hz = _FASTEST_HZ * _CONTROLLER_BYTES_PER_S / most
    return warning(what, found, f"stay below {rate_hz:.0f} Hz, or use a second controller")


def _libusb(cameras: Sequence[UsbDevice], seen: SeenByLibusb) -> Iterator[Finding]:
    try:
        opened = seen()
    except OSError as error:
        yield problem("libusb", str(error), "sudo apt-get install libusb-1.0-0")
        return
    missing = [c.serial for c in cameras if c.may_be_opened and c.serial not in opened]
    if missing:
        yield problem(
            "libusb",
            f"cannot read {', '.join(missing)}, though the kernel lists them",
            "plug the camera out and in; check the cable",
        )
    else:
        yield good("libusb", f"reads {len(opened)} devices of FLIR")
