"""The memory of the camera: GigE Vision's own registers, the features, and the description."""

from __future__ import annotations

import socket
import struct
import zlib
from dataclasses import dataclass

from rig.core.units import NS_PER_S
from rig.drivers.simulated.gige.features import Feature, FeatureTable, register_stride
from rig.drivers.simulated.gige.genicam import describe, packed

VERSION = 0x0000
DEVICE_MODE = 0x0004
MAC_HIGH, MAC_LOW = 0x0008, 0x000C
IP_CONFIG_SUPPORTED, IP_CONFIG_CURRENT = 0x0010, 0x0014
IP_ADDRESS, IP_MASK = 0x0024, 0x0034
VENDOR_NAME, MODEL_NAME, DEVICE_VERSION, VENDOR_INFO = 0x0048, 0x0068, 0x0088, 0x00A8
SERIAL_NUMBER, USER_NAME = 0x00D8, 0x00E8
DISCOVERY_BYTES = 0x00F8
FIRST_URL = 0x0200
N_INTERFACES, N_STREAM_CHANNELS = 0x0600, 0x0904
CAPABILITY, HEARTBEAT_TIMEOUT = 0x0934, 0x0938
TICKS_HIGH, TICKS_LOW = 0x093C, 0x0940
TIMESTAMP_CONTROL, TIMESTAMP_LATCHED = 0x0944, 0x0948
CONTROL_PRIVILEGE = 0x0A00
STREAM_PORT, PACKET_BYTES, PACKET_DELAY, STREAM_ADDRESS = 0x0D00, 0x0D04, 0x0D08, 0x0D18

WRITABLE = frozenset(
    {
        HEARTBEAT_TIMEOUT,
        TIMESTAMP_CONTROL,
        CONTROL_PRIVILEGE,
        STREAM_PORT,
        PACKET_BYTES,
        PACKET_DELAY,
        STREAM_ADDRESS,
    }
)
"""The registers below the features that a client may write."""

DEFAULT_HEARTBEAT_MS = 3000
DEFAULT_PACKET_BYTES = 1400
_CAN_CONCATENATE, _CAN_WRITE_MEMORY, _CAN_RESEND = 1 << 0, 1 << 1, 1 << 2
_CAN_HEARTBEAT_OFF = 1 << 29
_DESCRIPTION_ADDRESS = 0x20000


class AccessDenied(Exception):
    """The register cannot be written, or not now."""


class BadAddress(Exception):
    """There is nothing at this address."""


class BadValue(Exception):
    """The register does not take this value."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Who the camera is on the network."""

    vendor: str
    model: str
    serial: str
    ip_address: str


class Registers:
    """Bytes by address, and the same bytes as values by the name of a feature."""

    def __init__(self, table: FeatureTable, identity: Identity) -> None:
        self.table = table
        description = packed(describe(table, identity.model))
        self._memory = bytearray(_DESCRIPTION_ADDRESS + -(-len(description) // 4) * 4)
        self._by_address: dict[int, tuple[Feature, int]] = {}
        for feature in table.features:
            self._place(feature)
        self._bootstrap(identity, description)

    def read(self, address: int, size: int) -> bytes:
        """Return bytes; raises BadAddress beyond the memory."""
        if address < 0 or address + size > len(self._memory):
            raise BadAddress(f"nothing at 0x{address:x}")
        return bytes(self._memory[address : address + size])

    def feature_at(self, address: int) -> tuple[Feature, int] | None:
        """Return the feature whose register begins at an address, and which of its copies."""
        return self._by_address.get(address)

    def store(self, address: int, data: bytes, *, locked: bool) -> None:
        """Take what a client writes; raises AccessDenied, BadAddress or BadValue.

        `locked` says that pictures are being taken.
        """
        found = self._by_address.get(address)
        if found is None:
            if address not in WRITABLE or len(data) != 4:
                raise AccessDenied(f"0x{address:x} cannot be written")
        else:
            _check(found[0], data, locked)
        self._memory[address : address + len(data)] = data

    def word(self, address: int) -> int:
        """Return the 32-bit word at an address."""
        return int(struct.unpack_from(">I", self._memory, address)[0])

    def set_word(self, address: int, value: int) -> None:
        """Store a 32-bit word."""
        struct.pack_into(">I", self._memory, address, value & 0xFFFFFFFF)

    def number(self, name: str, copy: int = 0) -> float:
        """Return the value of a feature that is a number."""
        feature = self.table[name]
        place = feature.address + copy * register_stride(feature)
        return _unpack(feature, self._memory[place : place + feature.length])

    def word_of(self, name: str, copy: int = 0) -> str:
        """Return the entry of a feature that is an enumeration."""
        value = int(self.number(name, copy))
        return next(word for word, number in self.table[name].entries if number == value)

    def copy_of(self, selector: str, entry: str) -> int:
        """Return the number of an entry of a selector."""
        return dict(self.table[selector].entries)[entry]

    def set_number(self, name: str, value: float, copy: int = 0) -> None:
        """Store the value of a feature; one that this camera does not have is left out."""
        if name not in self.table:
            return
        feature = self.table[name]
        place = feature.address + copy * register_stride(feature)
        self._memory[place : place + feature.length] = _pack(feature, value)

    def _place(self, feature: Feature) -> None:
        for copy in range(self.table.copies(feature)):
            place = feature.address + copy * register_stride(feature)
            self._by_address[place] = (feature, copy)
            self._memory[place : place + feature.length] = _pack(feature, feature.value)

    def _bootstrap(self, identity: Identity, description: bytes) -> None:
        self._memory[_DESCRIPTION_ADDRESS : _DESCRIPTION_ADDRESS + len(description)] = description
        url = f"Local:camera.zip;{_DESCRIPTION_ADDRESS:x};{len(description):x}"
        for address, text, room in (
            (VENDOR_NAME, identity.vendor, 32),
            (MODEL_NAME, identity.model, 32),
            (DEVICE_VERSION, "simulated", 32),
            (VENDOR_INFO, "simulated camera", 48),
            (SERIAL_NUMBER, identity.serial, 16),
            (FIRST_URL, url, 512),
        ):
            encoded = text.encode()[: room - 1]
            self._memory[address : address + len(encoded)] = encoded
        ip_address = socket.inet_aton(identity.ip_address)
        for address, value in (
            (VERSION, 0x0002_0000),
            (DEVICE_MODE, 0x8000_0001),
            (MAC_HIGH, 0x0000_0200),
            (MAC_LOW, zlib.crc32(identity.serial.encode() + ip_address)),
            (IP_CONFIG_SUPPORTED, 0x7),
            (IP_CONFIG_CURRENT, 0x5),
            (IP_ADDRESS, int.from_bytes(ip_address, "big")),
            (IP_MASK, 0xFF00_0000),
            (N_INTERFACES, 1),
            (N_STREAM_CHANNELS, 1),
            (CAPABILITY, _CAN_CONCATENATE | _CAN_WRITE_MEMORY | _CAN_RESEND | _CAN_HEARTBEAT_OFF),
            (HEARTBEAT_TIMEOUT, DEFAULT_HEARTBEAT_MS),
            (TICKS_LOW, NS_PER_S),
            (PACKET_BYTES, DEFAULT_PACKET_BYTES),
        ):
            self.set_word(address, value)


def _check(feature: Feature, data: bytes, locked: bool) -> None:
    if feature.access == "RO" or (feature.locked and locked):
        raise AccessDenied(feature.name)
    if len(data) != feature.length:
        raise BadAddress(f"{feature.name} has {feature.length} bytes")
    value = _unpack(feature, data)
    below = feature.low is not None and not value >= feature.low
    above = feature.high is not None and not value <= feature.high
    unknown = feature.entries and value not in {number for _, number in feature.entries}
    if below or above or unknown:
        raise BadValue(f"{feature.name} cannot be {value:g}")


def _pack(feature: Feature, value: float | str) -> bytes:
    if isinstance(value, str):
        return value.encode()[: feature.length - 1].ljust(feature.length, b"\0")
    if feature.kind == "float":
        return struct.pack(">d", value)
    return int(value).to_bytes(feature.length, "big")


def _unpack(feature: Feature, data: bytes | bytearray) -> float:
    if feature.kind == "float":
        return float(struct.unpack(">d", data)[0])
    return int.from_bytes(data, "big")
