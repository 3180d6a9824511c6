"""A chunk while it fills: pictures are kept as they are, never copied."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from mcap.opcode import Opcode

from rig.record.cdr import Buffer
from rig.record.codec import Message
from rig.record.container import CHUNK_HEADER, MESSAGE_HEADER, RECORD_HEADER
from rig.record.hashes import Summed, crc_over
from rig.record.index import Places

_COPY_BELOW_BYTES = 1 << 15
_STORED = struct.Struct("<Q")
_HEAD_BYTES = RECORD_HEADER.size + CHUNK_HEADER.size + _STORED.size


@dataclass(slots=True)
class OpenChunk:
    """Collects records; short ones are joined, pictures stay views until they are written."""

    size: int = 0
    places: Places = field(default_factory=dict)
    _parts: list[Buffer | Summed] = field(default_factory=list)
    _short: bytearray = field(default_factory=bytearray)
    _first_ns: int | None = None
    _last_ns: int = 0

    @property
    def times_ns(self) -> tuple[int, int]:
        """Return the first and the last log time."""
        return self._first_ns or 0, self._last_ns

    @property
    def stored_bytes(self) -> int:
        """Return the size of the chunk record with its header."""
        return _HEAD_BYTES + self.size

    def add_records(self, records: bytes) -> None:
        """Add whole records that are no messages."""
        self._append(records)

    def add(self, channel: int, message: Message) -> None:
        """Add a message on a channel."""
        time_ns = message.log_time_ns
        self.places.setdefault(channel, []).append((time_ns, self.size))
        length = MESSAGE_HEADER.size + message.size
        self._append(RECORD_HEADER.pack(Opcode.MESSAGE, length))
        self._append(MESSAGE_HEADER.pack(channel, message.sequence, time_ns, time_ns))
        for part in message.parts:
            self._append(part)
        self._first_ns = time_ns if self._first_ns is None else min(self._first_ns, time_ns)
        self._last_ns = max(self._last_ns, time_ns)

    def sealed(self) -> list[Buffer]:
        """Return the whole chunk record as parts to write one after the other."""
        parts = [*self._parts, self._short]
        crc = 0
        for part in parts:
            crc = crc_over(crc, part)
        first_ns, last_ns = self.times_ns
        body = CHUNK_HEADER.pack(first_ns, last_ns, self.size, crc, 0) + _STORED.pack(self.size)
        head = RECORD_HEADER.pack(Opcode.CHUNK, len(body) + self.size) + body
        return [head, *(part.data if isinstance(part, Summed) else part for part in parts)]

    def _append(self, part: Buffer | Summed) -> None:
        size = len(part)
        self.size += size
        if size < _COPY_BELOW_BYTES:
            self._short += part.data if isinstance(part, Summed) else part
            return
        self._parts += [self._short, part]
        self._short = bytearray()
