"""One MCAP file of a run while it is being written; a long run has several."""

from __future__ import annotations

import time
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, McapRecord, Metadata, Schema

from rig.core.types import SIDES
from rig.record import codec, topics
from rig.record.chunk import OpenChunk
from rig.record.codec import Message
from rig.record.container import MAGIC, Extent
from rig.record.file import RecordingFile
from rig.record.header import RunHeader, to_attachments, to_metadata
from rig.record.index import Index, pack

_LIBRARY = "exposure-rig"
_INDEX_BYTES_PER_CHUNK = 256


class Part:
    """Writes one file: header, chunks of whole triggers, index.

    OSError from any method but `close` leaves a file that ends in an unfinished record; a part
    that cannot be begun leaves none.
    """

    def __init__(
        self,
        path: Path,
        header: RunHeader,
        facts: dict[str, dict[str, str]],
        *,
        reserve_bytes: int,
        live: bool,
    ) -> None:
        """Create the file with what is known before its first trigger; `facts` is more metadata."""
        self.path = path
        self._header = header
        self._reserve_bytes = reserve_bytes
        self._index = Index()
        self._chunk = OpenChunk()
        self._file = RecordingFile(path, reserve_bytes=reserve_bytes, live=live)
        self._began_s = 0.0
        self._described = False
        try:
            self._begin(facts)
        except OSError:
            self._file.discard()
            raise
        self._channels = self._register()

    def _begin(self, facts: dict[str, dict[str, str]]) -> None:
        """Write what is known before the first trigger and make the disk keep it."""
        header = self._header
        self._file.write([MAGIC, pack([Header("ros2", _LIBRARY)])])
        for name, data in to_attachments(header).items():
            attachment = Attachment(0, 0, name, "application/json", data)
            self._index.add_attachment(*self._write(attachment), attachment)
        for name, values in {**facts, **to_metadata(header)}.items():
            self._index.add_metadata(*self._write(Metadata(name, values)), name)
        self._file.settle()

    @property
    def full(self) -> bool:
        """Return whether the disk is full and only the room kept back is left."""
        return self._file.full

    @property
    def size(self) -> int:
        """Return how many bytes the file has with the open chunk."""
        return self._file.tell() + self._chunk.size

    def take(self, messages: list[Message], time_ns: int, chunk_bytes: int) -> None:
        """Add the messages of one trigger; the chunk closes once it has `chunk_bytes`."""
        if not self._chunk.places:
            self._began_s = time.monotonic()
        self._describe_cameras(time_ns)
        for message in messages:
            self._chunk.add(self._channels[message.topic], message)
        if self._chunk.size >= chunk_bytes:
            self._close_chunk()

    def close_older_than(self, age_s: float) -> None:
        """Close the chunk when its first trigger came longer ago."""
        if time.monotonic() - self._began_s >= age_s:
            self._close_chunk()

    def finish(self, time_ns: int, name: str, values: dict[str, str]) -> None:
        """Write the last chunk, one more metadata record and the index.

        The disk keeps the data before it sees the index: a file with an end has no holes.
        """
        self._describe_cameras(time_ns)
        self._close_chunk()
        self._file.settle()
        self._file.write([self._index.ending(self._file.tell(), (name, values))])

    def close(self) -> None:
        """Bring the file to the disk; raises OSError."""
        self._file.close()

    def _register(self) -> dict[str, int]:
        """Number schemas and channels; the first chunk begins with them."""
        schemas: dict[str, int] = {}
        for topic, kind in topics.TOPICS.items():
            if kind.name not in schemas:
                schemas[kind.name] = len(schemas) + 1
                schema = Schema(
                    schemas[kind.name], kind.definition.encode(), "ros2msg", kind.ros_name
                )
                self._index.schemas[schema.id] = schema
                self._chunk.add_records(pack([schema]))
            id_ = len(self._index.channels) + 1
            channel = Channel(
                id=id_,
                topic=topic,
                message_encoding="cdr",
                metadata={},
                schema_id=schemas[kind.name],
            )
            self._index.channels[id_] = channel
            self._chunk.add_records(pack([channel]))
        return {channel.topic: id_ for id_, channel in self._index.channels.items()}

    def _describe_cameras(self, time_ns: int) -> None:
        if self._described:
            return
        self._described = True
        for side, intrinsics in zip(SIDES, self._header.intrinsics, strict=True):
            message = codec.camera_info(side, intrinsics, time_ns)
            self._chunk.add(self._channels[message.topic], message)

    def _close_chunk(self) -> None:
        if not self._chunk.places:
            return
        chunk, self._chunk = self._chunk, OpenChunk()
        extent = Extent(Opcode.CHUNK, self._file.tell(), chunk.stored_bytes)
        sizes = (chunk.size, chunk.size)
        following = self._index.add_chunk(extent, chunk.times_ns, sizes, chunk.places)
        self._file.write([*chunk.sealed(), following])
        self._file.hold(self._needed_to_end())

    def _needed_to_end(self) -> int:
        """Return the bytes that one more chunk, the index and a margin take, in whole margins."""
        size = 2 * self._index.largest_chunk + _INDEX_BYTES_PER_CHUNK * self._index.chunks
        return self._reserve_bytes * (1 + -(-size // self._reserve_bytes))

    def _write(self, record: McapRecord) -> tuple[int, int]:
        """Write one record; return where it starts and its size."""
        builder = RecordBuilder()
        record.write(builder)
        start, data = self._file.tell(), builder.end()  # type: ignore[no-untyped-call]
        self._file.write([data])
        return start, len(data)
