"""USB3 Vision as bytes: commands, the registers that it defines itself, and a picture's packets."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from rig.drivers.simulated.gige.features import CHUNKS
from rig.drivers.simulated.gige.gvsp import Picture

SUCCESS, NOT_IMPLEMENTED, INVALID_PARAMETER = 0x0000, 0x8001, 0x8002
INVALID_ADDRESS, WRITE_PROTECT = 0x8003, 0x8004

READ, WRITE = 0x0800, 0x0802

_COMMAND_MAGIC = 0x43563355
_LEADER_MAGIC, _TRAILER_MAGIC = 0x4C563355, 0x54563355
_HEADER = struct.Struct("<IHHHH")
_IMAGE, _IMAGE_WITH_CHUNKS = 0x0001, 0x4001
LEADER_BYTES, TRAILER_BYTES = 52, 32
_MAX_TRANSFER_BYTES = 1024

_SBRM, _SIRM, _MANIFEST = 0x1000, 0x2000, 0x3000
MEMORY_BYTES = 0x4000
STREAM_CONTROL, _STREAM_PAYLOAD_BYTES = _SIRM + 0x04, _SIRM + 0x08
_ZIPPED_XML_1_1 = 1 << 24 | 1 << 16 | 1 << 10


@dataclass(frozen=True)
class Command:
    """A read of `size` bytes, or a write of `data`."""

    code: int
    request: int
    address: int
    size: int
    data: bytes


def parse(packet: bytes) -> Command:
    magic, _, code, _, request = _HEADER.unpack_from(packet)
    assert magic == _COMMAND_MAGIC
    (address,) = struct.unpack_from("<Q", packet, _HEADER.size)
    if code == READ:
        (size,) = struct.unpack_from("<H", packet, _HEADER.size + 10)
        return Command(code, request, address, size, b"")
    data = packet[_HEADER.size + 8 :]
    return Command(code, request, address, len(data), data)


def answer(command: Command, data: bytes, status: int = SUCCESS) -> bytes:
    head = _HEADER.pack(_COMMAND_MAGIC, status, command.code + 1, len(data), command.request)
    return head + data


def write_answer(command: Command, status: int = SUCCESS) -> bytes:
    written = command.size if status == SUCCESS else 0
    return answer(command, struct.pack("<HH", 0, written), status)


def bootstrap(maker: str, model: str, serial: str, xml_at: int, xml_bytes: int) -> bytearray:
    """Return the registers that USB3 Vision defines; the description is a zip at `xml_at`."""
    memory = bytearray(MEMORY_BYTES)
    for at, text in ((0x04, maker), (0x44, model), (0x144, serial)):
        memory[at : at + len(text)] = text.encode()
    for at, form, *values in (
        (0x000, "<I", 0x0001_0000),
        (0x1CC, "<I", 200),
        (0x1D0, "<QQ", _MANIFEST, _SBRM),
        (_SBRM + 0x14, "<II", _MAX_TRANSFER_BYTES, _MAX_TRANSFER_BYTES),
        (_SBRM + 0x1C, "<I", 1),
        (_SBRM + 0x20, "<Q", _SIRM),
        (_SIRM + 0x10, "<II", LEADER_BYTES, TRAILER_BYTES),
        (_MANIFEST, "<Q", 1),
        (_MANIFEST + 0x08, "<IIQQ", 0x0100_0000, _ZIPPED_XML_1_1, xml_at, xml_bytes),
    ):
        struct.pack_into(form, memory, at, *values)
    return memory


def tell_size(memory: bytearray, payload_bytes: int) -> None:
    struct.pack_into("<Q", memory, _STREAM_PAYLOAD_BYTES, payload_bytes)


def packets(picture: Picture) -> tuple[bytes, bytes, bytes]:
    """Return the leader of a picture, what follows its pixels in the payload, and the trailer."""
    kind = _IMAGE_WITH_CHUNKS if picture.chunks else _IMAGE
    tail = _tail(picture)
    payload_bytes = len(picture.pixels) + len(tail)
    leader = struct.pack(
        "<IHHQHHQIIIIIHH",
        *(_LEADER_MAGIC, 0, LEADER_BYTES, picture.block, 0, kind, picture.timestamp_ns),
        *(picture.pixel_format, picture.width_px, picture.height_px, 0, 0, 0, 0),
    )
    trailer = struct.pack(
        "<IHHQIQI",
        *(_TRAILER_MAGIC, 0, TRAILER_BYTES, picture.block, 0, payload_bytes, picture.height_px),
    )
    return leader, tail, trailer


def _tail(picture: Picture) -> bytes:
    if not picture.chunks:
        return b""
    tail = struct.pack("<II", CHUNKS["Image"], len(picture.pixels))
    for number, value in picture.chunks:
        tail += value + struct.pack("<II", number, len(value))
    return tail
