"""The control channel: who may write, what a write sets off, and whether the client still lives."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

from rig.drivers.simulated.gige import gvcp, registers
from rig.drivers.simulated.gige.gvcp import Command, Malformed
from rig.drivers.simulated.gige.imager import Imager
from rig.drivers.simulated.gige.registers import AccessDenied, BadAddress, BadValue, Registers

Sender = tuple[str, int]

_NS_PER_MS = 1_000_000
_CONTROL_BITS = 0x3
_LATCH_TIMESTAMP = 2
_FIRE_TEST_PACKET = 0x8000_0000


@dataclass(slots=True)
class ControlChannel:
    """Answers one client that holds control, and reads of anybody."""

    registers: Registers
    imager: Imager
    resend: Callable[[gvcp.Resend], None]
    send_test_packet: Callable[[int], None]
    controller: Sender | None = None
    heard_ns: int = 0
    _last_write: tuple[Sender, int, int, bytes] | None = None
    _last_reply: bytes | None = None

    def handle(self, packet: bytes, sender: Sender, now_ns: int) -> bytes | None:
        """Return the answer to a packet; None for what is no command and what asks for none."""
        try:
            command = gvcp.parse(packet)
        except Malformed:
            return None
        if sender == self.controller:
            self.heard_ns = now_ns
        try:
            return self._answer(command, sender, now_ns)
        except (Malformed, struct.error):
            return gvcp.answer(command, status=gvcp.INVALID_PARAMETER)
        except BadAddress:
            return gvcp.answer(command, status=gvcp.INVALID_ADDRESS)

    def check_heartbeat(self, now_ns: int) -> None:
        """Let go of a client that was not heard for longer than the heartbeat time-out."""
        timeout_ns = self.registers.word(registers.HEARTBEAT_TIMEOUT) * _NS_PER_MS
        if self.controller is not None and now_ns - self.heard_ns > timeout_ns:
            self.release()

    def release(self) -> None:
        """Forget the client and stop taking pictures."""
        self.controller = None
        self.registers.set_word(registers.CONTROL_PRIVILEGE, 0)
        self.imager.stop()

    def _answer(self, command: Command, sender: Sender, now_ns: int) -> bytes | None:
        if command.code == gvcp.DISCOVERY:
            return gvcp.answer(command, self.registers.read(0, registers.DISCOVERY_BYTES))
        if command.code == gvcp.READ_REGISTERS:
            words = (self.registers.read(address, 4) for address in gvcp.addresses(command))
            return gvcp.answer(command, b"".join(words))
        if command.code == gvcp.READ_MEMORY:
            address, size = gvcp.memory_range(command)
            if size > gvcp.MAX_MEMORY_BYTES:
                return gvcp.answer(command, status=gvcp.INVALID_PARAMETER)
            found = self.registers.read(address, size)
            return gvcp.answer(command, struct.pack(">I", address) + found)
        if command.code in (gvcp.WRITE_REGISTERS, gvcp.WRITE_MEMORY):
            reply = self._write_once(command, sender, now_ns)
            return reply if command.wants_answer else None
        if command.code == gvcp.PACKET_RESEND:
            self.resend(gvcp.resend(command))
            return None
        return gvcp.answer(command, status=gvcp.NOT_IMPLEMENTED) if command.wants_answer else None

    def _write_once(self, command: Command, sender: Sender, now_ns: int) -> bytes | None:
        """Obey a write; one that a client repeats, because no answer came, is answered only."""
        write = (sender, command.request, command.code, command.payload)
        if write != self._last_write:
            self._last_reply = self._write_all(command, sender, now_ns)
            self._last_write = write
        return self._last_reply

    def _write_all(self, command: Command, sender: Sender, now_ns: int) -> bytes:
        written = 0
        for write in gvcp.writes(command):
            status = self._write(write, sender, now_ns)
            if status != gvcp.SUCCESS:
                return gvcp.write_answer(command, written, status)
            written += 1
        return gvcp.write_answer(command, written)

    def _write(self, write: gvcp.Write, sender: Sender, now_ns: int) -> int:
        if self.controller not in (None, sender):
            return gvcp.ACCESS_DENIED
        claims = write.address == registers.CONTROL_PRIVILEGE
        if self.controller is None and not claims:
            return gvcp.ACCESS_DENIED
        try:
            self.registers.store(write.address, write.data, locked=self.imager.taking)
        except AccessDenied:
            return gvcp.WRITE_PROTECT
        except BadValue:
            return gvcp.INVALID_PARAMETER
        found = self.registers.feature_at(write.address)
        if found is None:
            self._bootstrap_written(write.address, sender, now_ns)
        else:
            self.imager.obey(found[0])
        return gvcp.SUCCESS

    def _bootstrap_written(self, address: int, sender: Sender, now_ns: int) -> None:
        value = self.registers.word(address)
        if address == registers.CONTROL_PRIVILEGE:
            if value & _CONTROL_BITS:
                self.controller, self.heard_ns = sender, now_ns
            else:
                self.release()
        elif address == registers.TIMESTAMP_CONTROL and value & _LATCH_TIMESTAMP:
            self._latch(registers.TIMESTAMP_LATCHED)
        elif address == registers.PACKET_BYTES:
            self.registers.set_word(address, value & 0xFFFF)
            if value & _FIRE_TEST_PACKET:
                self.send_test_packet(value & 0xFFFF)

    def _latch(self, address: int) -> None:
        now_ns = self.imager.now_ns()
        self.registers.set_word(address, now_ns >> 32)
        self.registers.set_word(address + 4, now_ns)
