"""The stream channel: packets on their way, and those kept to be sent again."""

from __future__ import annotations

import socket
from collections import OrderedDict, deque
from dataclasses import dataclass, field

from rig.drivers.simulated.gige import registers
from rig.drivers.simulated.gige.faults import Faults
from rig.drivers.simulated.gige.gvcp import Resend
from rig.drivers.simulated.gige.gvsp import Packet, Picture, packets, short_block
from rig.drivers.simulated.gige.registers import Registers

KEPT_PICTURES = 4
"""How many pictures can still be asked for again."""

MAX_QUEUED_PICTURES = 3
"""Pictures that wait for the cable; the next one is dropped and counted."""

BURST_BYTES = 512 * 1024
"""What is sent before the control channel is looked at again."""

_SEND_BUFFER_BYTES = 4 << 20


@dataclass(slots=True)
class StreamChannel:
    """Sends pictures to the client that the registers name."""

    registers: Registers
    faults: Faults
    sender: socket.socket
    extended: bool = True
    _queue: deque[deque[Packet]] = field(default_factory=deque)
    _kept: OrderedDict[int, list[Packet]] = field(default_factory=OrderedDict)
    _due_ns: int = 0
    _connected: tuple[str, int] | None = None

    def __post_init__(self) -> None:
        self.sender.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)

    def take(self, picture: Picture) -> None:
        """Queue a picture; without room it is dropped and counted in the camera."""
        if len(self._queue) >= MAX_QUEUED_PICTURES:
            lost = self.registers.number("TransferQueueOverflowCount") + 1
            self.registers.set_number("TransferQueueOverflowCount", lost)
            return
        packet_bytes = self.registers.word(registers.PACKET_BYTES)
        block = packets(picture, packet_bytes, extended=self.extended)
        self._kept[picture.block if self.extended else short_block(picture.block)] = block
        while len(self._kept) > KEPT_PICTURES:
            self._kept.popitem(last=False)
        self._queue.append(deque(self._spoiled(block)))

    def forget(self) -> None:
        """Drop everything that is still to be sent."""
        self._queue.clear()
        self._kept.clear()

    def next_due_ns(self) -> int | None:
        """Return when the next packet may go; None when there is none."""
        return self._due_ns if self._queue else None

    def send_some(self, now_ns: int) -> None:
        """Send what is due, a burst at most."""
        delay_ns = self.registers.word(registers.PACKET_DELAY)
        destination = self._destination()
        left_bytes = BURST_BYTES
        while self._queue and now_ns >= self._due_ns and left_bytes > 0:
            left_bytes -= self._send(self._queue[0].popleft(), destination)
            if not self._queue[0]:
                self._queue.popleft()
            if delay_ns:
                self._due_ns = max(self._due_ns, now_ns - delay_ns) + delay_ns

    def resend(self, wanted: Resend) -> None:
        """Send packets of a kept picture again."""
        if self.faults.refuse_resend:
            return
        destination = self._destination()
        for packet in self._kept.get(wanted.block, [])[wanted.first : wanted.last + 1]:
            self._send(packet, destination)

    def send_test_packet(self, packet_bytes: int) -> None:
        """Send one packet of this size, by which a client finds out what the network carries."""
        self._send((b"\0" * max(packet_bytes - 28, 0), memoryview(b"")), self._destination())

    def _spoiled(self, block: list[Packet]) -> list[Packet]:
        """Return the packets as they leave the camera, faults included."""
        leader, payload, trailer = block[0], block[1:-1], block[-1]
        if self.faults.reorder_packets:
            payload = [
                packet for at in range(0, len(payload), 2) for packet in payload[at : at + 2][::-1]
            ]
        lost = min(self.faults.lose_packets, len(payload))
        self.faults.lose_packets -= lost
        middle = (len(payload) - lost) // 2
        return [leader, *payload[:middle], *payload[middle + lost :], trailer]

    def _destination(self) -> tuple[str, int]:
        address = self.registers.word(registers.STREAM_ADDRESS)
        port = self.registers.word(registers.STREAM_PORT) & 0xFFFF
        return socket.inet_ntoa(address.to_bytes(4, "big")), port

    def _send(self, packet: Packet, destination: tuple[str, int]) -> int:
        if not destination[1]:
            return 0
        try:
            if destination != self._connected:
                self._connect(destination)
            return self.sender.sendmsg(packet)
        except OSError:
            return 0

    def _connect(self, destination: tuple[str, int]) -> None:
        """Send to one client from now on, which is quicker than to name it for every packet."""
        self.sender.connect(destination)
        self.sender.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)  # of a client that hung up
        self._connected = destination
