"""Walks a recording that may be damaged and collects what the index at its end must say."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field

from mcap.opcode import Opcode

from rig.core.errors import RecordingDamaged
from rig.core.units import NS_PER_S
from rig.record import container
from rig.record.container import MAGIC, RECORD_HEADER, Chunk, Container, Extent, damage
from rig.record.index import Index, Places

_PRIVATE = 0x80
"""Added to an opcode, this makes a record that every reader skips (MCAP specification)."""
_UNSYNCED_NS = 2 * NS_PER_S
"""Lost power tears no more than this off the end; what lies further back was on the disk."""
_BLOCK_BYTES = 16 << 20
_CHUNK_START = re.compile(rb"\x06(?=.{3}[\x00-\x08]\x00{4})", re.DOTALL)


def places_of(chunk: Chunk) -> Places:
    """Return where each channel's messages are, channels by first appearance."""
    found: Places = {}
    for opcode, offset, body in container.chunk_records(chunk.records):
        if opcode == Opcode.MESSAGE:
            id_, time_ns = container.message_key(body)
            found.setdefault(id_, []).append((time_ns, offset))
    return found


def note_channels(records: memoryview, index: Index) -> None:
    """Put the schemas and channels among the records of a chunk or an index into an index."""
    for opcode, _, body in container.chunk_records(records):
        if opcode == Opcode.SCHEMA:
            schema = container.parse(opcode, body)
            index.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = container.parse(opcode, body)
            index.channels[channel.id] = channel


@dataclass(slots=True)
class Scan:
    """Walks the data section once; `patches` are the (offset, bytes) that must be changed."""

    source: Container
    end: int = len(MAGIC)
    patches: list[tuple[int, bytes]] = field(default_factory=list)
    skipped_chunks: int = 0
    index: Index = field(default_factory=Index)

    def run(self) -> None:
        """Walk to the end of the data, or to where nothing more can be read."""
        first = next(self.source.extents(), None)
        if first is None or first.opcode != Opcode.HEADER:
            return
        self._note_old_index()
        while True:
            extent = next(self.source.extents(self.end), None)
            if extent is None or (extent.opcode not in _EXPECTED and extent.opcode < _PRIVATE):
                if not self._step_over_gap():
                    return
                continue
            if extent.opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            if not self._take(extent):
                return

    def _note_old_index(self) -> None:
        """Begin with the channels of the index: their own records lie in the first chunk alone."""
        with suppress(RecordingDamaged), damage(self.source.path):
            note_channels(self.source.summary().body, self.index)

    def unreadable_bytes(self) -> int:
        """Return how much is dropped; raises RecordingDamaged when it is more than a cut leaves."""
        dropped = max(0, self.source.size - self.end)
        allowed = 2 * self.index.largest_chunk + _BLOCK_BYTES
        if self._has_data_behind(self.end + allowed) and self.next_chunk(self.end) is None:
            raise RecordingDamaged(
                f"{self.source.path} is unreadable from byte {self.end} on, {dropped} bytes: more "
                "than a cut leaves; nothing was changed"
            )
        return dropped

    def _take(self, extent: Extent) -> bool:
        """Note one record; returns False where the file was torn by a crash."""
        if extent.opcode == Opcode.CHUNK:
            return self._take_chunk(extent)
        self.end = extent.end
        if extent.opcode == Opcode.MESSAGE_INDEX:
            self._hide(extent)
        elif extent.opcode == Opcode.ATTACHMENT:
            self.index.add_attachment(extent.start, extent.size, self.source.parsed(extent))
        elif extent.opcode == Opcode.METADATA:
            self.index.add_metadata(extent.start, extent.size, self.source.parsed(extent).name)
        return True

    def _take_chunk(self, extent: Extent) -> bool:
        try:
            chunk = container.read_chunk(self.source.body(extent))
            places = self._places(chunk) if chunk.crc_holds else None
        except ValueError:
            places = None
        if places is not None:
            self.end = extent.end
            self._add_chunk(extent, chunk, places)
            return True
        head = self.source.bytes_at(extent.start, RECORD_HEADER.size + container.CHUNK_HEAD_BYTES)
        if container.plain_chunk_bytes(head) is None:
            return self._step_over_gap()
        if self._is_torn_end(extent.end):
            return False
        self.end = extent.end
        self.skipped_chunks += 1
        self._hide(extent)
        return True

    def _places(self, chunk: Chunk) -> Places:
        places = places_of(chunk)
        note_channels(chunk.records, self.index)
        return places

    def _add_chunk(self, extent: Extent, chunk: Chunk, places: Places) -> None:
        """Note a chunk, and step over the index records that must follow or plan to write them."""
        following = self.index.add_chunk(
            extent,
            (chunk.start_time_ns, chunk.end_time_ns),
            (chunk.compressed_bytes, len(chunk.records)),
            places,
            chunk.compression,
        )
        there = self.source.bytes_at(self.end, len(following))
        if there[:1] == bytes([Opcode.CHUNK]):
            raise RecordingDamaged(
                f"{self.source.path} has no message index at byte {self.end}: it was not written "
                "by rig; nothing was changed"
            )
        if there != following:
            self.patches.append((self.end, following))
        self.end += len(following)

    def _step_over_gap(self) -> bool:
        """Hide what cannot be read, up to the next chunk; returns False when it ends the file."""
        following = self.next_chunk(self.end)
        if following is None or self._is_torn_end(following.start):
            return False
        gap = following.start - self.end - RECORD_HEADER.size
        if gap < 0:
            return False
        self.patches.append((self.end, RECORD_HEADER.pack(_PRIVATE, gap)))
        self.skipped_chunks += 1
        self.end = following.start
        return True

    def _is_torn_end(self, start: int) -> bool:
        """Return whether what follows `start` is no more than a crash leaves behind unsynced."""
        if self.source.bytes_at(self.source.size - len(MAGIC), len(MAGIC)) == MAGIC:
            return False
        last_ns = self.index.end_time_ns
        later = [self._end_time_ns(chunk) for chunk in self._chunks_behind(start)]
        return all(time_ns - last_ns <= _UNSYNCED_NS for time_ns in later)

    def _chunks_behind(self, start: int) -> Iterator[Extent]:
        while (chunk := self.next_chunk(start)) is not None:
            yield chunk
            start = chunk.end

    def _end_time_ns(self, chunk: Extent) -> int:
        data = self.source.bytes_at(chunk.start + RECORD_HEADER.size + 8, 8)
        return int.from_bytes(data, "little")

    def next_chunk(self, start: int) -> Extent | None:
        """Return the first sound uncompressed chunk at or behind `start`."""
        while start < self.source.size:
            block = self.source.bytes_at(start, _BLOCK_BYTES + RECORD_HEADER.size)
            for found in _CHUNK_START.finditer(block[: _BLOCK_BYTES + 8]):
                extent = self._sound_chunk(start + found.start())
                if extent is not None:
                    return extent
            start += _BLOCK_BYTES
        return None

    def _sound_chunk(self, start: int) -> Extent | None:
        """Return the chunk that begins at `start`, if one does; its sizes are checked first."""
        head = self.source.bytes_at(start, RECORD_HEADER.size + container.CHUNK_HEAD_BYTES)
        size = container.plain_chunk_bytes(head)
        extent = Extent(Opcode.CHUNK, start, RECORD_HEADER.size + (size or 0))
        if size is None or extent.end > self.source.size:
            return None
        try:
            return extent if container.read_chunk(self.source.body(extent)).crc_holds else None
        except ValueError:
            return None

    def _has_data_behind(self, start: int) -> bool:
        starts = range(start, self.source.size, _BLOCK_BYTES)
        return any(self.source.bytes_at(start, _BLOCK_BYTES).strip(b"\0") for start in starts)

    def _hide(self, extent: Extent) -> None:
        self.patches.append((extent.start, bytes([extent.opcode | _PRIVATE])))


_EXPECTED = frozenset(
    {
        Opcode.HEADER,
        Opcode.FOOTER,
        Opcode.SCHEMA,
        Opcode.CHANNEL,
        Opcode.MESSAGE,
        Opcode.CHUNK,
        Opcode.MESSAGE_INDEX,
        Opcode.CHUNK_INDEX,
        Opcode.ATTACHMENT,
        Opcode.ATTACHMENT_INDEX,
        Opcode.STATISTICS,
        Opcode.METADATA,
        Opcode.METADATA_INDEX,
        Opcode.SUMMARY_OFFSET,
        Opcode.DATA_END,
    }
)
"""Records below the private range that may stand in a file; another one is damage."""
