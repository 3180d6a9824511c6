"""GigE Vision stream protocol: a picture as packets, without any state."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

from rig.drivers.simulated.gige.features import CHUNKS

_LEADER, _TRAILER, _PAYLOAD = 1, 2, 3
_IMAGE, _IMAGE_WITH_CHUNKS = 0x0001, 0x4001
_IP_AND_UDP_BYTES = 28
_STANDARD_HEADER_BYTES, _EXTENDED_HEADER_BYTES = 8, 20

Packet = tuple[bytes, memoryview]
"""A header and what follows it, so that pixels need not be copied."""

_NOTHING = memoryview(b"")


@dataclass(frozen=True, slots=True)
class Picture:
    """What one block carries: pixels, and the chunks that follow them."""

    block: int
    timestamp_ns: int
    width_px: int
    height_px: int
    pixel_format: int
    pixels: memoryview
    chunks: tuple[tuple[int, bytes], ...] = ()


def packets(picture: Picture, packet_bytes: int, *, extended: bool) -> list[Packet]:
    """Return leader, payload and trailer; `packet_bytes` counts the IP and UDP headers as well.

    With `extended` ids are of 64 bits, without a block's id is of 16 bits and never 0.
    """
    header = _extended_header(picture.block) if extended else _standard_header(picture.block)
    header_bytes = _EXTENDED_HEADER_BYTES if extended else _STANDARD_HEADER_BYTES
    room = packet_bytes - _IP_AND_UDP_BYTES - header_bytes
    parts = _parts(picture, room)
    payload = [(header(_PAYLOAD, number), part) for number, part in enumerate(parts, start=1)]
    kind = _IMAGE_WITH_CHUNKS if picture.chunks else _IMAGE
    leader = struct.pack(
        ">HHQIIIIIHH",
        0,
        kind,
        picture.timestamp_ns,
        picture.pixel_format,
        picture.width_px,
        picture.height_px,
        0,
        0,
        0,
        0,
    )
    trailer = struct.pack(">HHI", 0, kind, picture.height_px)
    return [
        (header(_LEADER, 0) + leader, _NOTHING),
        *payload,
        (header(_TRAILER, len(parts) + 1) + trailer, _NOTHING),
    ]


def short_block(count: int) -> int:
    """Return the 16-bit id of the block numbered `count` from 1; 0 is left out (GigE Vision)."""
    return (count - 1) % 0xFFFF + 1


def chunk_bytes(sizes: list[int]) -> int:
    """Return how much the chunks of these sizes add to a picture, its own trailer included."""
    return 8 + sum(size + 8 for size in sizes)


def _parts(picture: Picture, room: int) -> list[memoryview]:
    """Return what each packet carries; only pixels that share one with chunks are copied."""
    pixels, whole = picture.pixels, len(picture.pixels) // room * room
    rest = memoryview(bytes(pixels[whole:]) + _tail(picture))
    return [
        *(pixels[at : at + room] for at in range(0, whole, room)),
        *(rest[at : at + room] for at in range(0, len(rest), room)),
    ]


def _tail(picture: Picture) -> bytes:
    """Return the chunks that follow the pixels."""
    if not picture.chunks:
        return b""
    tail = struct.pack(">II", CHUNKS["Image"], len(picture.pixels))
    for number, value in picture.chunks:
        tail += value + struct.pack(">II", number, len(value))
    return tail


def _extended_header(block: int) -> Callable[[int, int], bytes]:
    def header(kind: int, packet: int) -> bytes:
        return struct.pack(">HHIQI", 0, 0, 0x8000_0000 | kind << 24, block, packet)

    return header


def _standard_header(block: int) -> Callable[[int, int], bytes]:
    def header(kind: int, packet: int) -> bytes:
        return struct.pack(">HHI", 0, short_block(block), kind << 24 | packet)

    return header
