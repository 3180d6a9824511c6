"""The rule by which the kernel lets users open cameras."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from rig.core.errors import RigError
from rig.drivers.machine import ROOT

NAME = "99-exposure-rig.rules"

RULE = """\
# Lets everybody open USB3 Vision cameras of FLIR (vendor 1e10) and keeps them from being suspended.
SUBSYSTEM=="usb", ATTRS{idVendor}=="1e10", MODE:="0666", TAG+="uaccess"
ACTION=="add", SUBSYSTEM=="usb", ENV{DEVTYPE}=="usb_device", ATTR{idVendor}=="1e10", \
TEST=="power/control", ATTR{power/control}="on"
"""


def install(root: Path = ROOT) -> Path:
    """Write the rule and make the kernel obey it; return where. Raises RigError without the right.

    Cameras that are plugged in already obey it once they are plugged in again.
    """
    file = root / "etc/udev/rules.d" / NAME
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(RULE, encoding="utf-8")
    except OSError as error:
        raise RigError(
            f"{file} cannot be written ({error.strerror}): run sudo .venv/bin/rig doctor "
            "--install-udev"
        ) from error
    if root == ROOT and shutil.which("udevadm") is not None:
        for arguments in (("control", "--reload-rules"), ("trigger", "--subsystem-match=usb")):
            subprocess.run(["udevadm", *arguments], check=False, capture_output=True)
    return file
