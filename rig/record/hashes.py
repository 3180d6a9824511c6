"""Fingerprints that bind pictures to what is said about them."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from functools import lru_cache

from rig.record.cdr import Buffer

HASH_BYTES = 8
_POLYNOMIAL = 0xEDB88320
_ONE = 1 << 31


@dataclass(frozen=True, slots=True)
class Summed:
    """Bytes whose CRC-32 is known, so that long ones are gone through once for two checksums."""

    data: Buffer
    crc: int

    def __len__(self) -> int:
        return len(self.data)


NOTHING = Summed(b"", 0)


def summed(data: Buffer) -> Summed:
    """Return `data` with its CRC-32."""
    return Summed(data, zlib.crc32(data))


def crc_over(crc: int, part: Buffer | Summed) -> int:
    """Return the CRC-32 of what `crc` is of, with `part` behind it."""
    if isinstance(part, Summed):
        return _times(_shift(len(part)), crc) ^ part.crc
    return zlib.crc32(part, crc)


def fingerprint(*parts: Buffer | Summed) -> int:
    """Return a 64-bit hash of the parts in order: CRC-32 above Adler-32.

    Two independent checksums at memory speed. They prove that nothing was mixed up or damaged;
    they are no signature against someone who recomputes them.
    """
    crc, adler = 0, 1
    for part in parts:
        crc = crc_over(crc, part)
        adler = zlib.adler32(part.data if isinstance(part, Summed) else part, adler)
    return crc << 32 | adler


def sealed(message: bytes, *bound: Buffer | Summed) -> bytes:
    """Return `message` with its last 8 bytes, a uint64 field, set to the seal."""
    body = message[:-HASH_BYTES]
    return body + struct.pack("<Q", fingerprint(*bound, body))


def seal_holds(message: Buffer, *bound: Buffer) -> bool:
    """Return whether the last 8 bytes of `message` seal the rest of it and `bound`."""
    view = memoryview(message)
    (claimed,) = struct.unpack("<Q", view[-HASH_BYTES:])
    return bool(claimed == fingerprint(*bound, view[:-HASH_BYTES]))


def _times(a: int, b: int) -> int:
    """Return the product of two polynomials over GF(2) modulo the CRC's, bits reflected."""
    product = 0
    while a:
        if a & _ONE:
            product ^= b
        a = a << 1 & 0xFFFFFFFF
        b = b >> 1 ^ (_POLYNOMIAL if b & 1 else 0)
    return product


@lru_cache(maxsize=64)
def _shift(size: int) -> int:
    """Return x to the power of 8 * `size`: what `size` bytes behind a CRC multiply it by."""
    power, square = _ONE, _ONE >> 8
    while size:
        if size & 1:
            power = _times(square, power)
        square = _times(square, square)
        size >>= 1
    return power
