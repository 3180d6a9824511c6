"""The whole examination."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from rig.drivers import connected
from rig.drivers.aravis.binding import aravis_version
from rig.drivers.connected import Connected
from rig.drivers.doctor import library, network, usb
from rig.drivers.doctor.findings import Finding, warning
from rig.drivers.doctor.library import Version
from rig.drivers.doctor.usb import SeenByLibusb, seen_by_libusb
from rig.drivers.machine import ROOT, usb_devices


@dataclass(frozen=True, slots=True)
class Patient:
    """The computer that is examined: the root of its files, and whom to ask about the rest."""

    root: Path = ROOT
    aravis: Callable[[], Version] = aravis_version
    libusb: SeenByLibusb = seen_by_libusb
    network: Callable[[], list[Connected]] = field(
        default_factory=lambda: connected.network_cameras
    )


def examine(patient: Patient | None = None) -> Iterator[Finding]:
    """Yield every finding, in the order in which one would look."""
    patient = patient or Patient()
    on_usb = len(list(usb_devices(patient.root)))
    on_network = patient.network()
    if on_usb + len(on_network) < 2:
        yield warning(
            "cameras",
            f"{on_usb + len(on_network)} found, a pair is two",
            "plug them in; without cameras everything runs on the simulated pair",
        )
    yield from library.examine(patient.aravis, on_usb)
    yield from usb.examine(patient.root, patient.libusb)
    yield from network.examine(on_network, patient.root)
