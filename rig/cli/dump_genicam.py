"""`rig dump-genicam`: the description that a camera gives of itself."""

from __future__ import annotations

from pathlib import Path

from rig.cli.exits import OK
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.errors import RigError


def dump_genicam(
    camera: str,
    /,
    *,
    out: Path | None = None,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Write the GenICam XML of a camera to a file.

    Parameters
    ----------
    camera:
        Its serial number, decimal or hexadecimal, or its network address.
    out:
        File to write; SERIAL.xml when absent.
    """
    from rig.drivers.aravis.binding import described

    serial, xml = described(camera)
    file = out or Path(f"{serial}.xml")
    if file.exists():
        raise RigError(f"{file} exists, nothing is overwritten: name a new file with --out")
    file.write_text(xml, encoding="utf-8")
    terminal.result(
        f"{serial}: {file}, {len(xml)} characters", {"serial": serial, "file": str(file)}
    )
    return OK
