"""The MCAP file of a run while it is being written."""

from __future__ import annotations

from pathlib import Path
from typing import IO, cast

from mcap.writer import CompressionType, Writer

from rig.core.types import SIDES, PairRecord
from rig.record import codec, topics
from rig.record.file import RecordingFile
from rig.record.header import RunHeader, header_hash, to_attachments, to_metadata
from rig.record.totals import NAME, Totals

CHUNK_BYTES = 1 << 20
_NEVER = 1 << 62
_RESERVE_BYTES = 8 << 20
_INDEX_BYTES_PER_CHUNK = 256


class Sink:
    """Puts triggers into chunks that hold whole triggers only, so that a cut never splits one.

    A chunk closes with the first trigger that fills it to 1 MiB. OSError from any method but
    `close_file` leaves a file that ends in an unfinished record: close it and recover it.
    """

    def __init__(self, path: Path, header: RunHeader, *, live: bool) -> None:
        self._header = header
        self._file = RecordingFile(path, reserve_bytes=_RESERVE_BYTES, live=live)
        self._writer = Writer(
            cast(IO[bytes], self._file), chunk_size=_NEVER, compression=CompressionType.NONE
        )
        self._last = codec.Tie(chain=header_hash(header))
        self._open_bytes = 0
        self._chunks = 0
        self._largest_chunk = 0
        self._totals = Totals()
        self._writer.start(profile="ros2")
        for name, data in to_attachments(header).items():
            self._writer.add_attachment(0, 0, name, "application/json", data)
        for name, values in to_metadata(header).items():
            self._writer.add_metadata(name, values)
        self._channels = self._register()

    @property
    def triggers(self) -> int:
        """Return the number of triggers written."""
        return self._totals.triggers

    @property
    def full(self) -> bool:
        """Return whether the disk is full and only the room kept back is left."""
        return self._file.full

    def take(self, record: PairRecord) -> None:
        """Write one trigger; raises ValueError, with nothing written, for what cannot be packed."""
        messages, self._last = codec.encode(record, self._last)
        if not self.triggers:
            self._describe_cameras(self._last.time_ns)
        for message in messages:
            self._add(message)
        self._totals.add(record.cause)
        if self._open_bytes >= CHUNK_BYTES:
            self._close_chunk()

    def finish(self) -> None:
        """Write the last chunk, the totals and the index."""
        if not self.triggers:
            self._describe_cameras(0)
        self._close_chunk()
        self._writer.add_metadata(NAME, self._totals.to_metadata())
        self._writer.finish()  # type: ignore[no-untyped-call]

    def close_file(self) -> None:
        """Bring the file to the disk; raises OSError."""
        self._file.close()

    def _register(self) -> dict[str, int]:
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for topic, kind in topics.TOPICS.items():
            if kind.name not in schemas:
                schemas[kind.name] = self._writer.register_schema(
                    kind.ros_name, "ros2msg", kind.definition.encode()
                )
            channels[topic] = self._writer.register_channel(topic, "cdr", schemas[kind.name])
        return channels

    def _describe_cameras(self, time_ns: int) -> None:
        for side, intrinsics in zip(SIDES, self._header.intrinsics, strict=True):
            self._add(codec.camera_info(side, intrinsics, time_ns))

    def _add(self, message: codec.Message) -> None:
        self._writer.add_message(
            channel_id=self._channels[message.topic],
            log_time=message.log_time_ns,
            data=bytes(message.data),
            publish_time=message.log_time_ns,
            sequence=message.sequence,
        )
        self._open_bytes += len(message.data)

    def _close_chunk(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._chunks += 1
        self._largest_chunk = max(self._largest_chunk, self._open_bytes)
        self._open_bytes = 0
        self._file.hold(self._needed_to_end())

    def _needed_to_end(self) -> int:
        """Return the bytes that one more chunk, the index and a margin take, in whole margins."""
        size = 2 * self._largest_chunk + _INDEX_BYTES_PER_CHUNK * self._chunks
        return _RESERVE_BYTES * (1 + -(-size // _RESERVE_BYTES))
