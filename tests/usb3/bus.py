"""The bus that stands in for libusb: built with gcc, loaded before Aravis, spoken to by ctypes."""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np

SOURCE = Path(__file__).with_name("stand_in.c")
HEADER = Path("/usr/include/libusb-1.0/libusb.h")
CANNOT_BUILD = "the USB stand-in needs gcc and libusb-1.0-0-dev"

Answer = Callable[[bytes], bytes]
"""Obeys a command of USB3 Vision and returns the answer."""

_ANSWER = ctypes.CFUNCTYPE(
    ctypes.c_int,
    ctypes.c_int,
    ctypes.POINTER(ctypes.c_char),
    ctypes.c_int,
    ctypes.c_void_p,
    ctypes.c_int,
)


def can_build() -> bool:
    return shutil.which("gcc") is not None and HEADER.exists()


def build(folder: Path) -> Path:
    """Return the shared object in `folder`, built unless it is there already."""
    digest = hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:16]
    built = folder / f"stand-in-{digest}.so"
    if not built.exists():
        folder.mkdir(parents=True, exist_ok=True)
        flags = ("-std=c11", "-D_GNU_SOURCE", "-O2", "-Wall", "-Wextra")
        new = built.with_suffix(f".{os.getpid()}")
        subprocess.run(
            ["gcc", *flags, "-shared", "-fPIC", "-o", new, SOURCE, "-lpthread"], check=True
        )
        new.rename(built)
    return built


class Bus:
    """The loaded stand-in; cameras are plugged into it."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library
        self._called: list[object] = []  # a thread that lets a camera go may still be calling

    def attach(self, maker: str, model: str, serial: str, answer: Answer) -> Plug:
        """Plug a camera in."""

        def obey(_: int, command: object, size: int, reply: int, room: int) -> int:
            told = answer(ctypes.string_at(command, size))[:room]
            ctypes.memmove(reply, told, len(told))
            return len(told)

        called = _ANSWER(obey)
        number = self._library.stand_in_attach(
            maker.encode(), model.encode(), serial.encode(), called
        )
        assert number >= 0, "no plug is left"
        self._called.append(called)
        return Plug(self._library, number)


class Plug:
    """Where one camera is plugged in."""

    def __init__(self, library: ctypes.CDLL, number: int) -> None:
        self._library, self._number = library, number

    def send(self, packet: bytes | memoryview, tail: bytes = b"") -> None:
        """Send one packet."""
        data = np.frombuffer(packet, np.uint8)
        start = ctypes.c_void_p(data.ctypes.data)
        self._library.stand_in_send(self._number, start, data.size, tail, len(tail))

    def unsent(self) -> int:
        """Return how many packets nobody has taken."""
        return int(self._library.stand_in_unsent(self._number))

    def state(self) -> str:
        """Return where packets and transfers are, for whoever waits in vain."""
        counts = [ctypes.c_int() for _ in range(3)]
        self._library.stand_in_count(self._number, *(ctypes.byref(count) for count in counts))
        waiting, filled, cut_short = (count.value for count in counts)
        return (
            f"{self.unsent()} packets nobody took; transfers: {waiting} waiting, "
            f"{filled} filled and not told, {cut_short} cut short"
        )

    def forget(self) -> None:
        """Drop the packets that nobody has taken."""
        self._library.stand_in_forget(self._number)

    def pull(self) -> None:
        self._library.stand_in_plug(self._number, 0)

    def push(self) -> None:
        self._library.stand_in_plug(self._number, 1)

    def forbid(self, forbidden: bool) -> None:
        """Let nobody open the camera, as without a udev rule."""
        self._library.stand_in_forbid(self._number, int(forbidden))

    def detach(self) -> None:
        self._library.stand_in_detach(self._number)


_LOADED: list[Bus] = []


def load(folder: Path) -> None:
    """Load the stand-in for everybody in this process; Aravis must come after it."""
    _LOADED.append(Bus(ctypes.CDLL(str(build(folder)), mode=ctypes.RTLD_GLOBAL)))


def bus() -> Bus:
    return _LOADED[0]


def is_loaded() -> bool:
    return bool(_LOADED)
