"""Makes a recording readable again that was cut by a crash, a full disk or lost power."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from rig.core.errors import RecordingDamaged, RecordingError
from rig.record import bag, container, header, topics, totals
from rig.record.container import MAGIC, Chunk, Container, Extent, damage
from rig.record.file import reserve_path

NAME = "rig.recovery"
_PRIVATE = 0x80
"""Added to an opcode, this makes a record that every reader skips (MCAP specification)."""
_MARGIN_BYTES = 16 << 20


@dataclass(frozen=True, slots=True)
class Recovery:
    """What `recover` found: nothing was changed unless `repaired`."""

    repaired: bool
    triggers: int
    chunks: int
    skipped_chunks: int
    dropped_bytes: int


def recover(path: Path | str) -> Recovery:
    """Repair a recording in place: keep every whole chunk, drop the cut tail, write the index.

    A chunk whose checksum is wrong in the middle of the file is hidden from readers, not removed.
    An intact file is left alone. Raises RecordingError when it cannot be read or written,
    RecordingDamaged, with nothing changed, when it is no recording or is more than cut.
    """
    file = container.find(Path(path))
    with damage(file), Container(file) as source:
        scan = _Scan(source)
        scan.run()
        ending = scan.ending()
        intact = not scan.patches and source.bytes_at(scan.end, len(ending) + 1) == ending
        dropped = 0 if intact else scan.unreadable_bytes()
    try:
        if not intact:
            _rewrite(file, scan.patches, scan.end, ending)
        reserve_path(file).unlink(missing_ok=True)
        bag.describe(file)
    except OSError as error:
        raise RecordingError(f"cannot repair {file}: {error.strerror}") from error
    return Recovery(
        not intact, scan.triggers, len(scan.chunk_indexes), scan.skipped_chunks, dropped
    )


def _rewrite(path: Path, patches: list[tuple[int, bytes]], end: int, ending: bytes) -> None:
    with path.open("r+b", buffering=0) as file:
        for start, data in patches:
            os.pwrite(file.fileno(), data, start)
        file.truncate(end)
        file.seek(end)
        while ending:
            ending = ending[file.write(ending) :]
        os.fsync(file.fileno())


@dataclass(slots=True)
class _Scan:
    """Walks the data section and collects what the index at its end must say."""

    source: Container
    end: int = len(MAGIC)
    patches: list[tuple[int, bytes]] = field(default_factory=list)
    skipped_chunks: int = 0
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    times_ns: list[int] = field(default_factory=list)
    chunk_indexes: list[ChunkIndex] = field(default_factory=list)
    attachment_indexes: list[AttachmentIndex] = field(default_factory=list)
    metadata_indexes: list[MetadataIndex] = field(default_factory=list)

    @property
    def triggers(self) -> int:
        """Return the number of triggers that were kept."""
        ids = [id_ for id_, channel in self.channels.items() if channel.topic == topics.PAIR]
        return sum(self.counts.get(id_, 0) for id_ in ids)

    def run(self) -> None:
        """Walk to the end of the data or to the cut; raises RecordingDamaged without a header."""
        while (extent := next(self.source.extents(self.end), None)) is not None:
            if extent.opcode in (Opcode.DATA_END, Opcode.FOOTER):
                break
            self._take(extent)
        if header.RUN not in {index.name for index in self.metadata_indexes}:
            raise RecordingDamaged(
                f"{self.source.path} ends before the run's first trigger; nothing to recover"
            )

    def _take(self, extent: Extent) -> None:
        self.end = extent.end
        if extent.opcode == Opcode.CHUNK:
            self._take_chunk(extent)
        elif extent.opcode == Opcode.MESSAGE_INDEX:
            self._hide(extent)
        elif extent.opcode == Opcode.ATTACHMENT:
            self.attachment_indexes.append(_attachment_index(self.source, extent))
        elif extent.opcode == Opcode.METADATA:
            name = self.source.parsed(extent).name
            self.metadata_indexes.append(
                MetadataIndex(offset=extent.start, length=extent.size, name=name)
            )

    def _take_chunk(self, extent: Extent) -> None:
        try:
            chunk = container.read_chunk(self.source.body(extent))
            indexes = self._index(chunk) if chunk.crc_holds else None
        except ValueError:
            indexes = None
        if indexes is None:
            self.skipped_chunks += 1
            self._hide(extent)
            return
        self._add_chunk(extent, chunk, indexes)

    def _index(self, chunk: Chunk) -> list[MessageIndex]:
        """Return where each channel's messages are, channels by first appearance."""
        found: dict[int, list[tuple[int, int]]] = {}
        for opcode, offset, body in container.chunk_records(chunk.records):
            if opcode == Opcode.SCHEMA:
                schema = container.parse(opcode, body)
                self.schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = container.parse(opcode, body)
                self.channels[channel.id] = channel
            elif opcode == Opcode.MESSAGE:
                id_, time_ns = container.message_key(body)
                found.setdefault(id_, []).append((time_ns, offset))
        return [MessageIndex(channel_id=id_, records=where) for id_, where in found.items()]

    def _add_chunk(self, extent: Extent, chunk: Chunk, indexes: list[MessageIndex]) -> None:
        offsets: dict[int, int] = {}
        start = extent.end
        for index in indexes:
            offsets[index.channel_id] = self.end
            self._expect(index)
            self.counts[index.channel_id] = self.counts.get(index.channel_id, 0) + len(
                index.records
            )
        self.times_ns += [chunk.start_time_ns, chunk.end_time_ns]
        self.chunk_indexes.append(
            ChunkIndex(
                message_start_time=chunk.start_time_ns,
                message_end_time=chunk.end_time_ns,
                chunk_start_offset=extent.start,
                chunk_length=extent.size,
                message_index_offsets=offsets,
                message_index_length=self.end - start,
                compression=chunk.compression,
                compressed_size=chunk.compressed_bytes,
                uncompressed_size=len(chunk.records),
            )
        )

    def _expect(self, index: MessageIndex) -> None:
        """Step over the index record that must come next; where it is cut, plan to write it."""
        data = _bytes([index])
        if self.source.bytes_at(self.end, len(data)) != data:
            self.patches.append((self.end, data))
        self.end += len(data)

    def _hide(self, extent: Extent) -> None:
        self.patches.append((extent.start, bytes([extent.opcode | _PRIVATE])))

    def unreadable_bytes(self) -> int:
        """Return how much is dropped; raises RecordingDamaged when it is more than a cut leaves."""
        largest = max((index.chunk_length for index in self.chunk_indexes), default=0)
        dropped = max(0, self.source.size - self.end)
        if dropped > 2 * largest + _MARGIN_BYTES and self._has_data_behind():
            raise RecordingDamaged(
                f"{self.source.path} is unreadable from byte {self.end} on, {dropped} bytes: more "
                "than a cut leaves; nothing was changed"
            )
        return dropped

    def _has_data_behind(self) -> bool:
        starts = range(self.end, self.source.size, _MARGIN_BYTES)
        return any(self.source.bytes_at(start, _MARGIN_BYTES).strip(b"\0") for start in starts)

    def ending(self) -> bytes:
        """Return the bytes from the end of the data section to the end of the file."""
        note = self._note()
        data_end = _bytes([DataEnd(0)])
        return note + data_end + self._summary(self.end + len(note) + len(data_end))

    def _note(self) -> bytes:
        """Return a metadata record that says so when triggers may be missing; nothing otherwise."""
        names = {index.name for index in self.metadata_indexes}
        if not self.skipped_chunks and names & {totals.NAME, NAME}:
            return b""
        facts = {"triggers": str(self.triggers), "skipped_chunks": str(self.skipped_chunks)}
        note = _bytes([Metadata(NAME, facts)])
        self.metadata_indexes.append(MetadataIndex(offset=self.end, length=len(note), name=NAME))
        return note

    def _summary(self, start: int) -> bytes:
        """Return index, footer and magic in the order in which the `mcap` library writes them."""
        groups: list[tuple[Opcode, Iterable[McapRecord]]] = [
            (Opcode.SCHEMA, self.schemas.values()),
            (Opcode.CHANNEL, self.channels.values()),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self.chunk_indexes),
            (Opcode.ATTACHMENT_INDEX, self.attachment_indexes),
            (Opcode.METADATA_INDEX, self.metadata_indexes),
        ]
        body, offsets = b"", []
        for opcode, records in groups:
            data = _bytes(records)
            offsets.append(SummaryOffset(opcode, start + len(body), len(data)))
            body += data
        footer = Footer(summary_start=start, summary_offset_start=start + len(body), summary_crc=0)
        body += _bytes(offsets)
        unsealed = _bytes([footer])[:-4]
        crc = zlib.crc32(body + unsealed)
        return body + unsealed + crc.to_bytes(4, "little") + MAGIC

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self.attachment_indexes),
            channel_count=len(self.channels),
            channel_message_counts=self.counts,
            chunk_count=len(self.chunk_indexes),
            message_count=sum(self.counts.values()),
            message_end_time=max(self.times_ns, default=0),
            message_start_time=min(self.times_ns, default=0),
            metadata_count=len(self.metadata_indexes),
            schema_count=len(self.schemas),
        )


def _bytes(records: Iterable[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _attachment_index(source: Container, extent: Extent) -> AttachmentIndex:
    attachment = source.parsed(extent)
    return AttachmentIndex(
        offset=extent.start,
        length=extent.size,
        create_time=attachment.create_time,
        log_time=attachment.log_time,
        data_size=len(attachment.data),
        name=attachment.name,
        media_type=attachment.media_type,
    )
