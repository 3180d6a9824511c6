"""`rig devices`: the real cameras that are connected."""

from __future__ import annotations

from dataclasses import asdict

from rig.cli.exits import OK
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.drivers.connected import Connected


def devices(*, terminal: Terminal = DEFAULT_TERMINAL) -> int:
    """List the cameras on USB and on the network; needs no camera library."""
    from rig.drivers.connected import connected_cameras

    found = connected_cameras()
    lines = [_line(camera) for camera in found]
    if len(found) > 1:
        names = ",".join(camera.serial for camera in found[:2])
        lines.append(f"as a pair, the primary first: --cameras aravis:{names}")
    elif not found:
        lines.append("no camera is connected; rig doctor looks for the reason")
    terminal.result("\n".join(lines), {"cameras": [asdict(camera) for camera in found]})
    return OK


def _line(camera: Connected) -> str:
    place = f"USB {camera.place}" if camera.link == "usb" else camera.place
    return f"{camera.serial}  {camera.model}  {place}"
