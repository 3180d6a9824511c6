"""The index at the end of an MCAP file, for the writer and for recovery alike."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
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

from rig.record.container import MAGIC, Extent

Places = dict[int, list[tuple[int, int]]]
"""By channel, (log time, offset in the chunk) of each message; channels by first appearance."""


@dataclass(slots=True)
class Index:
    """Collects what the end of a file must say; chunks cost some 200 bytes each."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    chunks: int = 0
    largest_chunk: int = 0
    end_time_ns: int = 0
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    _start_time_ns: int | None = None
    _chunk_indexes: bytearray = field(default_factory=bytearray)

    @property
    def metadata_names(self) -> set[str]:
        """Return the names of the metadata records in the file."""
        return {index.name for index in self.metadata}

    @property
    def attachment_names(self) -> set[str]:
        """Return the names of the attachments in the file."""
        return {index.name for index in self.attachments}

    def add_attachment(self, start: int, size: int, attachment: Attachment) -> None:
        """Note an attachment record of `size` bytes at `start`."""
        self.attachments.append(
            AttachmentIndex(
                offset=start,
                length=size,
                create_time=attachment.create_time,
                log_time=attachment.log_time,
                data_size=len(attachment.data),
                name=attachment.name,
                media_type=attachment.media_type,
            )
        )

    def add_metadata(self, start: int, size: int, name: str) -> None:
        """Note a metadata record of `size` bytes at `start`."""
        self.metadata.append(MetadataIndex(offset=start, length=size, name=name))

    def add_chunk(
        self,
        chunk: Extent,
        times_ns: tuple[int, int],
        sizes: tuple[int, int],
        places: Places,
        compression: str = "",
    ) -> bytes:
        """Note a chunk; return the message index records that must follow it.

        `times_ns` are its first and last, `sizes` its stored and its plain bytes.
        """
        offsets: dict[int, int] = {}
        following = bytearray()
        for channel, records in places.items():
            offsets[channel] = chunk.end + len(following)
            following += pack([MessageIndex(channel_id=channel, records=records)])
            self.counts[channel] = self.counts.get(channel, 0) + len(records)
        self._chunk_indexes += pack(
            [
                ChunkIndex(
                    message_start_time=times_ns[0],
                    message_end_time=times_ns[1],
                    chunk_start_offset=chunk.start,
                    chunk_length=chunk.size,
                    message_index_offsets=offsets,
                    message_index_length=len(following),
                    compression=compression,
                    compressed_size=sizes[0],
                    uncompressed_size=sizes[1],
                )
            ]
        )
        self.chunks += 1
        self.largest_chunk = max(self.largest_chunk, chunk.size)
        first_ns = self._start_time_ns
        self._start_time_ns = times_ns[0] if first_ns is None else min(first_ns, times_ns[0])
        self.end_time_ns = max(self.end_time_ns, times_ns[1])
        return bytes(following)

    def count(self, topic: str) -> int:
        """Return how many messages there are on a topic."""
        ids = [id_ for id_, channel in self.channels.items() if channel.topic == topic]
        return sum(self.counts.get(id_, 0) for id_ in ids)

    def ending(self, start: int, note: tuple[str, dict[str, str]] | None = None) -> bytes:
        """Return the bytes from `start`, the end of the data, to the end of the file.

        `note` is a last metadata record to put before them: its name and values.
        """
        data = b""
        if note is not None:
            data = pack([Metadata(*note)])
            self.add_metadata(start, len(data), note[0])
        data += pack([DataEnd(0)])
        return data + self._summary(start + len(data))

    def _summary(self, start: int) -> bytes:
        """Return index, footer and magic in the order in which the `mcap` library writes them."""
        groups: list[tuple[Opcode, bytes]] = [
            (Opcode.SCHEMA, pack(self.schemas.values())),
            (Opcode.CHANNEL, pack(self.channels.values())),
            (Opcode.STATISTICS, pack([self._statistics()])),
            (Opcode.CHUNK_INDEX, bytes(self._chunk_indexes)),
            (Opcode.ATTACHMENT_INDEX, pack(self.attachments)),
            (Opcode.METADATA_INDEX, pack(self.metadata)),
        ]
        body, offsets = bytearray(), []
        for opcode, data in groups:
            offsets.append(SummaryOffset(opcode, start + len(body), len(data)))
            body += data
        footer = Footer(summary_start=start, summary_offset_start=start + len(body), summary_crc=0)
        body += pack(offsets)
        unsealed = pack([footer])[:-4]
        crc = zlib.crc32(body + unsealed)
        return bytes(body + unsealed) + crc.to_bytes(4, "little") + MAGIC

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=self.counts,
            chunk_count=self.chunks,
            message_count=sum(self.counts.values()),
            message_end_time=self.end_time_ns,
            message_start_time=self._start_time_ns or 0,
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )


def pack(records: Iterable[McapRecord]) -> bytes:
    """Return records as they stand in the file, each with its header."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
