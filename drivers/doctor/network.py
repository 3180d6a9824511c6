"""GigE Vision: room for pictures that come faster than they are taken, and who answers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from rig.drivers.connected import Connected
from rig.drivers.doctor.findings import Finding, good, warning
from rig.drivers.machine import ROOT, socket_buffer_bytes

GOOD_BUFFER_BYTES = 4 << 20
"""What the driver asks for: a little more than one picture of 2048 x 1536."""


def examine(cameras: Sequence[Connected], root: Path = ROOT) -> Iterator[Finding]:
    """Yield what stands between this computer and the cameras that answered on the network."""
    told = ", ".join(f"{camera.model} {camera.serial} at {camera.place}" for camera in cameras)
    yield good("network cameras", told or "none answers a broadcast")
    yield _buffer(socket_buffer_bytes(root))


def _buffer(size_bytes: float | None) -> Finding:
    what = "receive buffer for network cameras"
    if size_bytes is None:
        return warning(what, "the kernel does not tell net.core.rmem_max", "check /proc/sys")
    found = f"net.core.rmem_max is {size_bytes:.0f} bytes"
    if size_bytes >= GOOD_BUFFER_BYTES:
        return good(what, found)
    return warning(
        what,
        f"{found}: a busy computer drops packets of large pictures and asks again",
        f"sudo sysctl -w net.core.rmem_max={GOOD_BUFFER_BYTES}; for good: write "
        f"net.core.rmem_max={GOOD_BUFFER_BYTES} to /etc/sysctl.d/60-cameras.conf",
    )
