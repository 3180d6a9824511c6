"""Aravis: whether it is here, and what is known of its version."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from rig.core.errors import CameraError
from rig.drivers.doctor.findings import Finding, good, problem, warning

Version = tuple[int, int, int]

SOUND_ON_USB: Version = (0, 8, 29)
"""The first version without the known faults of its USB streams."""


def examine(version: Callable[[], Version], usb_cameras: int) -> Iterator[Finding]:
    """Yield what is to be said of the library; `version` raises CameraError where it is not."""
    try:
        found = version()
    except CameraError as error:
        yield problem("Aravis", "not here", str(error).partition("; ")[2])
        return
    spelt = ".".join(map(str, found))
    if found >= SOUND_ON_USB or not usb_cameras:
        yield good("Aravis", spelt)
        return
    yield warning(
        "Aravis",
        f"{spelt}: on USB a stream that is closed may be waited for without end, and one that has "
        "no buffer left takes a whole core; the driver keeps 8 buffers under way",
        f"install Aravis {'.'.join(map(str, SOUND_ON_USB))} or newer; end a program that hangs "
        "when it closes with Ctrl-\\",
    )
