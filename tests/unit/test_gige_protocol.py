"""GigE Vision as bytes: commands, packets, registers, and the description of the camera."""

from __future__ import annotations

import io
import socket
import struct
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from served_pair import MODEL, plane_plan, served

from rig.core.errors import CameraError
from rig.core.types import Pair
from rig.drivers.aravis.probe import is_controlled
from rig.drivers.simulated.gige import gvcp, gvsp, registers
from rig.drivers.simulated.gige.features import make_table
from rig.drivers.simulated.gige.genicam import describe, packed
from rig.drivers.simulated.gige.registers import (
    AccessDenied,
    BadAddress,
    BadValue,
    Identity,
    Registers,
)
from rig.drivers.simulated.gige.server import Server

_READ, _WRITE = 0x80, 0x82
_CONTROL = registers.CONTROL_PRIVILEGE


def make_registers(hidden: frozenset[str] = frozenset()) -> Registers:
    table = make_table(MODEL, "SIM", 64, 48, hidden)
    return Registers(table, Identity("rig", MODEL.name, "SIM", "127.0.0.9"))


def picture(block: int = 1, chunks: tuple[tuple[int, bytes], ...] = ()) -> gvsp.Picture:
    pixels = np.arange(5_000, dtype=np.uint8).data
    return gvsp.Picture(block, 123, 100, 50, 0x01080009, pixels, chunks)


@given(st.binary(max_size=64))
def test_no_bytes_confuse_the_parser(packet: bytes) -> None:
    try:
        command = gvcp.parse(packet)
    except gvcp.Malformed:
        return
    for read in (gvcp.addresses, gvcp.memory_range, gvcp.writes, gvcp.resend):
        try:
            read(command)
        except gvcp.Malformed:
            continue


@pytest.mark.parametrize("extended", [True, False])
def test_packets_carry_every_pixel_once_and_in_order(extended: bool) -> None:
    block = gvsp.packets(picture(block=3), 576, extended=extended)
    header_bytes = 20 if extended else 8
    assert all(len(header) + len(data) <= 576 - 28 for header, data in block)
    assert b"".join(bytes(data) for _, data in block) == bytes(picture().pixels)
    kinds = [header[4] & 0x7F for header, _ in block]
    assert kinds == [1, *[3] * (len(block) - 2), 2]
    assert all(len(header) == header_bytes for header, _ in block[1:-1])
    numbers = [
        int.from_bytes(header[header_bytes - 3 : header_bytes], "big") for header, _ in block
    ]
    assert numbers == list(range(len(block)))


def test_a_block_id_of_16_bits_leaves_zero_out() -> None:
    assert [gvsp.short_block(count) for count in (1, 65_535, 65_536)] == [1, 65_535, 1]


def test_chunks_follow_the_pixels_and_name_themselves() -> None:
    block = gvsp.packets(picture(chunks=((3, b"12345678"),)), 9_000, extended=True)
    data = bytes(block[1][1])
    assert struct.unpack(">II", data[-8:]) == (3, 8)
    assert data[-16:-8] == b"12345678"
    assert struct.unpack(">II", data[-24:-16]) == (1, 5_000)
    assert len(data) == 5_000 + gvsp.chunk_bytes([8])


def test_a_description_is_whole_and_names_each_feature_once() -> None:
    memory = make_registers()
    xml = ElementTree.fromstring(describe(memory.table, MODEL.name))
    names = [node.attrib["Name"] for node in xml if "Name" in node.attrib]
    assert len(names) == len(set(names))
    told = {feature.text for feature in xml.iter() if feature.tag.endswith("pFeature")}
    assert told - set(names) == set()
    pointed = {
        node.text
        for node in xml.iter()
        if node.tag.split("}")[1] in ("pValue", "pIndex", "pPort", "pSelected")
    }
    assert pointed - set(names) == set()


def test_a_client_finds_the_description_by_its_url() -> None:
    memory = make_registers()
    url = memory.read(registers.FIRST_URL, 512).split(b"\0")[0].decode()
    name, address, size = url.removeprefix("Local:").split(";")
    with zipfile.ZipFile(io.BytesIO(memory.read(int(address, 16), int(size, 16)))) as archive:
        xml = archive.read("camera.xml").decode()
    assert name.endswith(".zip")
    assert xml == describe(memory.table, MODEL.name)
    assert packed(xml) == packed(xml)


def test_a_hidden_feature_is_not_told() -> None:
    xml = describe(make_registers(frozenset({"GammaEnable"})).table, MODEL.name)
    assert "GammaEnable" not in xml
    assert "BlackLevel" in xml


def store(memory: Registers, name: str, value: float, *, locked: bool = False) -> None:
    feature = memory.table[name]
    data = struct.pack(">d", value) if feature.kind == "float" else struct.pack(">I", int(value))
    memory.store(feature.address, data, locked=locked)


def test_a_register_takes_only_what_its_feature_takes() -> None:
    memory = make_registers()
    store(memory, "ExposureTime", 500.0)
    assert memory.number("ExposureTime") == 500.0
    for name, value in (("ExposureTime", 1.0), ("Gain", float("nan")), ("GainAuto", 7)):
        with pytest.raises(BadValue, match=name):
            store(memory, name, value)
    with pytest.raises(AccessDenied, match="SensorWidth"):
        store(memory, "SensorWidth", 64)
    with pytest.raises(AccessDenied, match="PixelFormat"):
        store(memory, "PixelFormat", 0x01080009, locked=True)
    with pytest.raises(AccessDenied):
        memory.store(registers.VENDOR_NAME, b"abcd", locked=False)
    with pytest.raises(BadAddress):
        memory.read(1 << 30, 4)


class Client:
    """Talks to a camera as a client does, byte by byte."""

    def __init__(self, address: str) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(2.0)
        self._to = (address, gvcp.PORT)
        self._request = 0

    def ask(self, code: int, payload: bytes, request: int | None = None) -> tuple[int, bytes]:
        """Return the status and the payload of the answer."""
        self._request += 1
        number = self._request if request is None else request
        self._socket.sendto(
            struct.pack(">BBHHH", 0x42, 1, code, len(payload), number) + payload, self._to
        )
        packet = self._socket.recv(1024)
        status, answered, size, told = struct.unpack_from(">HHHH", packet)
        assert (answered, size, told) == (code + 1, len(packet) - 8, number)
        return status, packet[8:]

    def write(self, address: int, value: int, request: int | None = None) -> int:
        """Return the status of a write."""
        return self.ask(_WRITE, struct.pack(">II", address, value), request)[0]

    def close(self) -> None:
        self._socket.close()


def test_one_client_controls_a_camera_until_it_falls_silent() -> None:
    with served(plane_plan()) as server:
        address = server.addresses.primary
        one, other = Client(address), Client(address)
        assert is_controlled(address) is False
        assert one.write(registers.HEARTBEAT_TIMEOUT, 300) == gvcp.ACCESS_DENIED
        assert one.write(_CONTROL, 2) == gvcp.SUCCESS
        assert one.write(registers.HEARTBEAT_TIMEOUT, 300) == gvcp.SUCCESS
        assert other.write(_CONTROL, 2) == gvcp.ACCESS_DENIED
        assert is_controlled(address) is True
        assert one.ask(_READ, struct.pack(">I", _CONTROL)) == (0, struct.pack(">I", 2))
        assert _until(lambda: is_controlled(address) is False)
        assert other.write(_CONTROL, 2) == gvcp.SUCCESS
        one.close()
        other.close()


def _until(true: object) -> bool:
    import time

    for _ in range(40):
        if true():
            return True
        time.sleep(0.05)
    return False


def test_a_repeated_trigger_is_answered_and_not_fired_again() -> None:
    with served(plane_plan()) as server:
        device = server.devices.primary
        client = Client(server.addresses.primary)
        client.write(_CONTROL, 2)
        table = device.imager.registers.table
        mode = table["TriggerMode"].address + 8
        client.write(mode, 1)
        client.write(table["AcquisitionStart"].address, 1)
        for _ in range(3):
            status = client.write(table["TriggerSoftware"].address, 1, request=77)
            assert status == gvcp.SUCCESS
        assert device.imager.software_triggers == 1
        client.close()


def test_wrong_commands_are_answered_with_why() -> None:
    with served(plane_plan()) as server:
        client = Client(server.addresses.secondary)
        assert client.ask(_READ, struct.pack(">I", 1 << 29))[0] == gvcp.INVALID_ADDRESS
        assert client.ask(_READ, b"abc")[0] == gvcp.INVALID_PARAMETER
        assert client.ask(0x0ABC, b"")[0] == gvcp.NOT_IMPLEMENTED
        client.write(_CONTROL, 2)
        assert client.write(registers.MODEL_NAME, 0) == gvcp.WRITE_PROTECT
        client.close()


def test_an_address_that_is_taken_is_named() -> None:
    with served(plane_plan()) as server:
        taken = server.addresses.primary
        with pytest.raises(CameraError, match=f"{taken}: no camera can be served there, UDP port"):
            Server(plane_plan(), Pair(taken, server.addresses.secondary))


def test_nobody_answers_where_no_camera_is() -> None:
    assert is_controlled("127.0.255.77") is None
