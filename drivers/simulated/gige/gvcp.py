"""GigE Vision control protocol: commands and answers as bytes, without any state."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NamedTuple

PORT = 3956
"""Where every GigE Vision camera listens."""

DISCOVERY, PACKET_RESEND = 0x0002, 0x0040
READ_REGISTERS, WRITE_REGISTERS = 0x0080, 0x0082
READ_MEMORY, WRITE_MEMORY = 0x0084, 0x0086

SUCCESS = 0x0000
NOT_IMPLEMENTED, INVALID_PARAMETER, INVALID_ADDRESS = 0x8001, 0x8002, 0x8003
WRITE_PROTECT, BAD_ALIGNMENT, ACCESS_DENIED = 0x8004, 0x8005, 0x8006

MAX_MEMORY_BYTES = 536
"""What one memory command may carry."""

_KEY = 0x42
_HEADER = struct.Struct(">BBHHH")
_ACK_WANTED, _EXTENDED_IDS = 0x01, 0x10


class Malformed(Exception):
    """The bytes are no command."""


class Write(NamedTuple):
    """Four or more bytes for an address."""

    address: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Command:
    """One command of a client."""

    code: int
    request: int
    payload: bytes
    wants_answer: bool
    extended: bool


@dataclass(frozen=True, slots=True)
class Resend:
    """A client asks for packets `first`..`last` of a block again."""

    block: int
    first: int
    last: int


def parse(packet: bytes) -> Command:
    """Return the command in a packet; raises Malformed."""
    if len(packet) < _HEADER.size:
        raise Malformed("too short")
    key, flags, code, size, request = _HEADER.unpack_from(packet)
    payload = packet[_HEADER.size :]
    if key != _KEY or len(payload) < size:
        raise Malformed("not a GVCP command")
    return Command(
        code, request, payload[:size], bool(flags & _ACK_WANTED), bool(flags & _EXTENDED_IDS)
    )


def answer(command: Command, payload: bytes = b"", status: int = SUCCESS) -> bytes:
    """Return the answer to a command."""
    return struct.pack(">HHHH", status, command.code + 1, len(payload), command.request) + payload


def addresses(command: Command) -> tuple[int, ...]:
    """Return the registers that a READREG asks for; raises Malformed."""
    if not command.payload or len(command.payload) % 4:
        raise Malformed("READREG takes whole addresses")
    return struct.unpack(f">{len(command.payload) // 4}I", command.payload)


def memory_range(command: Command) -> tuple[int, int]:
    """Return the address and size that a READMEM asks for; raises Malformed."""
    if len(command.payload) != 8:
        raise Malformed("READMEM takes an address and a size")
    address, size = struct.unpack(">II", command.payload)
    return address, size & 0xFFFF


def writes(command: Command) -> list[Write]:
    """Return what a WRITEREG or WRITEMEM writes; raises Malformed."""
    payload = command.payload
    if command.code == WRITE_MEMORY:
        if len(payload) < 8 or len(payload) % 4:
            raise Malformed("WRITEMEM takes an address and whole words")
        return [Write(int.from_bytes(payload[:4], "big"), payload[4:])]
    if not payload or len(payload) % 8:
        raise Malformed("WRITEREG takes pairs of address and value")
    return [
        Write(int.from_bytes(payload[at : at + 4], "big"), payload[at + 4 : at + 8])
        for at in range(0, len(payload), 8)
    ]


def write_answer(command: Command, written: int, status: int = SUCCESS) -> bytes:
    """Return the answer to a write of which `written` parts were taken."""
    return answer(command, struct.pack(">HH", 0, written), status)


def resend(command: Command) -> Resend:
    """Return what a PACKETRESEND asks for; raises Malformed."""
    if len(command.payload) < (20 if command.extended else 12):
        raise Malformed("PACKETRESEND is too short")
    _, block, first, last = struct.unpack_from(">HHII", command.payload)
    if command.extended:
        block = struct.unpack_from(">Q", command.payload, 12)[0]
        return Resend(block, first, last)
    return Resend(block, first & 0xFFFFFF, last & 0xFFFFFF)
