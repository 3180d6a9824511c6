"""Fingerprints that bind pictures to what is said about them."""

from __future__ import annotations

import struct
import zlib

from rig.record.cdr import Buffer

HASH_BYTES = 8


def fingerprint(*parts: Buffer) -> int:
    """Return a 64-bit hash of the parts in order: CRC-32 above Adler-32.

    Two independent checksums at memory speed, 2 GB/s together. They prove that nothing was mixed
    up or damaged; they are no signature against someone who recomputes them.
    """
    crc, adler = 0, 1
    for part in parts:
        crc, adler = zlib.crc32(part, crc), zlib.adler32(part, adler)
    return crc << 32 | adler


def sealed(message: bytes, *bound: Buffer) -> bytes:
    """Return `message` with its last 8 bytes, a uint64 field, set to the seal."""
    body = message[:-HASH_BYTES]
    return body + struct.pack("<Q", fingerprint(*bound, body))


def seal_holds(message: Buffer, *bound: Buffer) -> bool:
    """Return whether the last 8 bytes of `message` seal the rest of it and `bound`."""
    view = memoryview(message)
    (claimed,) = struct.unpack("<Q", view[-HASH_BYTES:])
    return bool(claimed == fingerprint(*bound, view[:-HASH_BYTES]))
