"""A quick look at whether a network camera still answers, past Aravis, which waits for seconds."""

from __future__ import annotations

import contextlib
import socket
import struct

_PORT = 3956
_READ_REGISTER, _READ_REGISTER_ANSWER = 0x0080, 0x0081
_CONTROL_PRIVILEGE, _CONTROL_BITS = 0x0A00, 0x3
_TRIES = 4
_WAIT_S = 0.1


def is_controlled(address: str, port: int = _PORT) -> bool | None:
    """Return whether some program controls the camera at an address; None when it is silent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking, contextlib.suppress(OSError):
        asking.settimeout(_WAIT_S)
        for request in range(1, _TRIES + 1):
            asking.sendto(_question(request), (address, port))
            with contextlib.suppress(TimeoutError):
                answer = _read(asking.recv(64))
                if answer is not None:
                    return bool(answer & _CONTROL_BITS)
    return None


def _question(request: int) -> bytes:
    return struct.pack(">BBHHHI", 0x42, 0x01, _READ_REGISTER, 4, request, _CONTROL_PRIVILEGE)


def _read(packet: bytes) -> int | None:
    if len(packet) != 12:
        return None
    status, code, _, _, value = struct.unpack(">HHHHI", packet)
    return int(value) if status == 0 and code == _READ_REGISTER_ANSWER else None
