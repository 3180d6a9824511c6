"""Reads MCAP records with every length checked before anything is allocated.

Record bodies are parsed by the `mcap` library or by hand; walking, limits and checksums are ours,
because a damaged file must end in one clear error and never in a wrong number of messages.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, Self

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from rig.core.errors import RecordingDamaged, RecordingError
from rig.record.codec import Message
from rig.record.topics import IMAGES

BAG_FILE = "metadata.yaml"
MAGIC = b"\x89MCAP0\r\n"
RECORD_HEADER = struct.Struct("<BQ")
CHUNK_HEADER = struct.Struct("<QQQII")
MESSAGE_HEADER = struct.Struct("<HIQQ")
_PART = re.compile(r"_([1-9]\d*)")
_FOOTER_BYTES = RECORD_HEADER.size + 20
_MAX_CHUNK_BYTES = 64 << 20
_MAX_SUMMARY_BYTES = 64 << 20
_MAX_RECORDS = 100_000
_MAX_PARSED_BYTES = 1 << 20
_MAX_SMALL_BYTES = 4 << 20
"""Of a chunk or an index: records, bytes of those that are parsed one by one, and bytes of the
messages that hold no picture. A recording stays far below."""
_MAX_BYTES: dict[int, int] = {
    Opcode.CHUNK: _MAX_CHUNK_BYTES,
    Opcode.ATTACHMENT: 16 << 20,
}
_CHUNK_INDEX = struct.Struct("<QQQQI")
_INDEX_ENTRY = struct.Struct("<HQ")

_LEAKS = (
    McapError,
    struct.error,
    ValueError,
    LookupError,
    TypeError,
    ArithmeticError,
    MemoryError,
    RecursionError,
    AttributeError,
)
"""What parsing of damaged bytes may raise."""

PARSERS: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.ATTACHMENT: Attachment,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.STATISTICS: Statistics,
}


_NEEDED = (
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.METADATA_INDEX,
    Opcode.ATTACHMENT_INDEX,
)
"""Of the index at the end, these are parsed."""
_MANY = (Opcode.MESSAGE, Opcode.CHUNK_INDEX)
"""There may be thousands of these, and they are never parsed as the library's dataclasses."""


@dataclass(frozen=True, slots=True)
class Extent:
    """Where one whole record lies: `size` counts its 9-byte header too."""

    opcode: int
    start: int
    size: int

    @property
    def end(self) -> int:
        """Return the offset of the byte after the record."""
        return self.start + self.size


@dataclass(frozen=True, slots=True)
class Chunk:
    """A chunk's records, its times and where they begin inside the chunk record."""

    start_time_ns: int
    end_time_ns: int
    compression: str
    compressed_bytes: int
    crc_holds: bool
    records: memoryview


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """Where a chunk lies, and by topic where the index of its messages does."""

    start: int
    size: int
    message_indexes: dict[str, int]


@dataclass(slots=True)
class Summary:
    """The index at the end of a file."""

    statistics: Statistics
    body: memoryview
    channels: dict[str, int] = field(default_factory=dict)
    metadata: list[MetadataIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)

    def messages(self, topic: str) -> int:
        """Return how many messages the file claims to hold on `topic`."""
        counts: dict[int, int] = self.statistics.channel_message_counts
        return counts.get(self.channels[topic], 0) if topic in self.channels else 0

    def chunks(self, topics: Iterable[str]) -> Iterator[ChunkPlace]:
        """Yield where each chunk lies, and the index of its messages on `topics`.

        Raises ValueError or struct.error for a bad entry.
        """
        wanted = {self.channels[topic]: topic for topic in topics if topic in self.channels}
        end = 0
        for opcode, _, body in chunk_records(self.body):
            if opcode != Opcode.CHUNK_INDEX:
                continue
            _, _, start, size, map_bytes = _CHUNK_INDEX.unpack_from(body)
            entries = _INDEX_ENTRY.iter_unpack(body[_CHUNK_INDEX.size :][:map_bytes])
            indexes = {wanted[id_]: at for id_, at in entries if id_ in wanted}
            if start < end or min(indexes.values(), default=start + size) < start + size:
                raise ValueError(f"the chunk at byte {start} and its index are not in order")
            end = max([start + size, *indexes.values()])
            yield ChunkPlace(start, size, indexes)


def find(path: Path) -> Path:
    """Return the first MCAP file that `path` names; raises RecordingError when there is not one."""
    if not path.exists():
        raise RecordingError(f"{path} does not exist; name a recording's folder or .mcap file")
    folder = path.parent if path.name == BAG_FILE else path
    if not folder.is_dir():
        first = first_part(path)
        if first != path:
            raise RecordingError(f"{path} is a later part of {first}; name that one")
        return path
    files = [file for file in sorted(folder.glob("*.mcap")) if first_part(file) == file]
    if len(files) != 1:
        count = "no .mcap file" if not files else f"{len(files)} .mcap files"
        raise RecordingError(f"{folder} holds {count}; name one recording")
    return files[0]


def part_path(first: Path, number: int) -> Path:
    """Return where part `number` of a run lies, counted from 0: `run.mcap`, `run_1.mcap`, ..."""
    return first.with_name(f"{first.stem}_{number}{first.suffix}") if number else first


def parts(first: Path) -> list[Path]:
    """Return the files of a run in order; raises RecordingError when one between is missing."""
    numbers = [int(found[1]) for found in map(_PART.fullmatch, _stems(first)) if found]
    found = [first, *(part_path(first, number) for number in range(1, max(numbers, default=0) + 1))]
    missing = [part for part in found if not part.exists()]
    if missing:
        raise RecordingError(f"{missing[0]} is missing; put the parts of a run into one folder")
    return found


def _stems(first: Path) -> list[str]:
    """Return, of the later parts beside `first`, the end of each name: `_1` and so on."""
    others = first.parent.glob(f"*{first.suffix}")
    return [each.stem.removeprefix(first.stem) for each in others if each != first]


def first_part(path: Path) -> Path:
    """Return the first part of the run that `path` is a part of."""
    found = re.fullmatch(r"(.+)_[1-9]\d*", path.stem)
    first = path.with_name(found[1] + path.suffix) if found else path
    return first if first.exists() else path


@contextmanager
def damage(path: Path, advice: str = "") -> Iterator[None]:
    """Turn whatever a damaged file or disk makes the code below raise into RecordingError."""
    try:
        yield
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror}") from error
    except _LEAKS as error:
        advice = advice or f"try: rig recover {path}"
        raise RecordingDamaged(f"{path} is damaged: {_said(error)}; {advice}") from error


def _said(error: Exception) -> str:
    if isinstance(error, KeyError):
        return f"{error.args[0]!r} is missing"
    return str(error).splitlines()[0] if str(error) else type(error).__name__


class Container:
    """An open MCAP file."""

    def __init__(self, path: Path) -> None:
        """Open `path`; raises RecordingError or, for what is no MCAP file, RecordingDamaged."""
        self.path = path
        try:
            self._fd = os.open(path, os.O_RDONLY)
        except OSError as error:
            raise RecordingError(f"cannot read {path}: {error.strerror}") from error
        self.size = os.fstat(self._fd).st_size
        if self.bytes_at(0, len(MAGIC)) != MAGIC:
            self.close()
            raise RecordingDamaged(f"{path} is no MCAP file; is it the right one?")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; closing twice is harmless."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def bytes_at(self, start: int, size: int) -> bytes:
        """Return up to `size` bytes at `start`: fewer at the end of the file."""
        return os.pread(self._fd, size, start)

    def extents(self, start: int = len(MAGIC)) -> Iterator[Extent]:
        """Walk the whole records from `start` on; stops silently where the file is cut."""
        while True:
            header = self.bytes_at(start, RECORD_HEADER.size)
            if len(header) < RECORD_HEADER.size:
                return
            opcode, length = RECORD_HEADER.unpack(header)
            extent = Extent(opcode, start, RECORD_HEADER.size + length)
            if opcode == 0 or extent.end > self.size:
                return
            yield extent
            start = extent.end

    def body(self, extent: Extent) -> bytearray:
        """Return a record without its header, writable and owned by the caller."""
        limit = _MAX_BYTES.get(extent.opcode, _MAX_PARSED_BYTES)
        size = extent.size - RECORD_HEADER.size
        if size > limit:
            raise ValueError(f"a record of {size} bytes at byte {extent.start} is over {limit}")
        return self.buffer_at(extent.start + RECORD_HEADER.size, size)

    def buffer_at(self, start: int, size: int) -> bytearray:
        """Return `size` bytes, writable; raises ValueError when they are too many or not there."""
        if not 0 <= size <= _MAX_CHUNK_BYTES:
            raise ValueError(f"{size} bytes at byte {start} are not 0..{_MAX_CHUNK_BYTES}")
        body = bytearray(size)
        if os.preadv(self._fd, [body], start) != size:
            raise ValueError(f"the record at byte {start} is cut")
        return body

    def message_offsets(self, chunk: ChunkPlace, topic: str) -> list[int]:
        """Return the offsets in a chunk of its messages on a topic, as the index behind it says."""
        start = chunk.message_indexes.get(topic)
        if start is None:
            return []
        extent = next(self.extents(start), None)
        if extent is None or extent.opcode != Opcode.MESSAGE_INDEX:
            raise ValueError(f"there is no message index at byte {start}")
        body = memoryview(self.body(extent))
        _, size = struct.unpack_from("<HI", body)
        return [offset for _, offset in struct.iter_unpack("<QQ", body[6 : 6 + size])]

    def parsed(self, extent: Extent) -> Any:
        """Return a small record as the library's dataclass."""
        return parse(extent.opcode, self.body(extent))

    def at(self, start: int, opcode: Opcode) -> Any:
        """Return the record that an index says is at `start`."""
        extent = next(self.extents(start), None)
        if extent is None or extent.opcode != opcode:
            raise ValueError(f"there is no {opcode.name.lower()} at byte {start}")
        return self.parsed(extent)

    def summary(self) -> Summary:
        """Return the index; raises ValueError when the file does not end in one."""
        end = self.size - len(MAGIC)
        tail = self.bytes_at(max(0, end - _FOOTER_BYTES), _FOOTER_BYTES + len(MAGIC))
        if len(tail) < _FOOTER_BYTES + len(MAGIC) or not tail.endswith(MAGIC):
            raise ValueError("the file is cut short")
        opcode, length = RECORD_HEADER.unpack_from(tail)
        if (opcode, length) != (Opcode.FOOTER, 20):
            raise ValueError("the footer is missing")
        footer = parse(Opcode.FOOTER, tail[RECORD_HEADER.size : _FOOTER_BYTES])
        start = footer.summary_start
        size = end - 4 - start
        if not 0 < start < end or size > _MAX_SUMMARY_BYTES:
            raise ValueError("the index is missing")
        body = self.bytes_at(start, size)
        if footer.summary_crc != zlib.crc32(body):
            raise ValueError("the checksum of the index is wrong")
        return _summary(memoryview(body)[: size - (_FOOTER_BYTES - 4)])

    def messages(self) -> Iterator[Message]:
        """Yield every message in file order; raises ValueError for a damaged chunk.

        Topics are told in the first chunk, and by the index where that is lost.
        """
        topics = self._indexed_topics()
        for extent in self.extents():
            if extent.opcode == Opcode.DATA_END:
                return
            if extent.opcode == Opcode.MESSAGE:
                raise ValueError(f"the message at byte {extent.start} is in no chunk")
            if extent.opcode == Opcode.CHUNK:
                chunk = read_chunk(self.body(extent))
                if not chunk.crc_holds:
                    raise ValueError(f"the checksum of the chunk at byte {extent.start} is wrong")
                yield from _messages(chunk, topics)
        raise ValueError("the file is cut short")

    def _indexed_topics(self) -> dict[int, str]:
        try:
            return {id_: topic for topic, id_ in self.summary().channels.items()}
        except (ValueError, KeyError, struct.error):
            return {}


def _summary(body: memoryview) -> Summary:
    groups: dict[int, list[Any]] = {opcode: [] for opcode in _NEEDED}
    for opcode, _, record in chunk_records(body):
        if opcode in groups:
            groups[opcode].append(parse(opcode, record))
    (statistics,) = groups[Opcode.STATISTICS]
    channels = {channel.topic: channel.id for channel in groups[Opcode.CHANNEL]}
    if len(channels) != len(groups[Opcode.CHANNEL]):
        raise ValueError("the index has a topic twice")
    return Summary(
        statistics, body, channels, groups[Opcode.METADATA_INDEX], groups[Opcode.ATTACHMENT_INDEX]
    )


def parse(opcode: int, body: bytes | bytearray | memoryview) -> Any:
    """Return a record's body as the library's dataclass; raises ValueError when it is too short."""
    stream = ReadDataStream(BytesIO(body))
    record = PARSERS[opcode].read(stream)
    if stream.count > len(body):
        raise ValueError(f"a {Opcode(opcode).name.lower()} record is too short")
    return record


def read_chunk(body: bytearray) -> Chunk:
    """Return a chunk, its records decompressed; raises ValueError when lengths do not fit."""
    view = memoryview(body)
    start_ns, end_ns, size, crc, name_size = CHUNK_HEADER.unpack_from(view)
    at = CHUNK_HEADER.size + name_size
    compression = bytes(view[CHUNK_HEADER.size : at]).decode()
    (stored,) = struct.unpack_from("<Q", view, at)
    data = view[at + 8 :]
    if len(data) != stored:
        raise ValueError(f"a chunk claims {stored} bytes and holds {len(data)}")
    records = inflate(data, compression, size)
    crc_holds = crc in (0, zlib.crc32(records))
    return Chunk(start_ns, end_ns, compression, stored, crc_holds, records)


CHUNK_HEAD_BYTES = CHUNK_HEADER.size + 8


def plain_chunk_bytes(head: bytes) -> int | None:
    """Return the body size of the uncompressed chunk that begins with `head`, else None.

    `head` is the record header and the fixed fields: three sizes in it must agree.
    """
    if len(head) < RECORD_HEADER.size + CHUNK_HEAD_BYTES:
        return None
    opcode, length = RECORD_HEADER.unpack_from(head)
    _, _, size, _, name_size = CHUNK_HEADER.unpack_from(head, RECORD_HEADER.size)
    (stored,) = struct.unpack_from("<Q", head, RECORD_HEADER.size + CHUNK_HEADER.size)
    agrees = opcode == Opcode.CHUNK and name_size == 0 and size == stored
    return length if agrees and length == CHUNK_HEAD_BYTES + size else None


def inflate(data: memoryview, compression: str, size: int) -> memoryview:
    """Return a chunk's data decompressed to `size` bytes; raises ValueError, not MemoryError."""
    if size > _MAX_CHUNK_BYTES:
        raise ValueError(f"a chunk of {size} bytes is over {_MAX_CHUNK_BYTES}")
    plain = _decompressed(data, compression, size + 1)
    if len(plain) != size:
        raise ValueError(f"a chunk claims {size} bytes and holds {len(plain)}")
    return plain


def _decompressed(data: memoryview, compression: str, limit: int) -> memoryview:
    """Return at most `limit` bytes of what `data` holds."""
    try:
        if compression == "":
            return data
        if compression == "zstd":
            import zstandard

            return memoryview(zstandard.ZstdDecompressor().stream_reader(data).read(limit))
        if compression == "lz4":
            from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

            return memoryview(LZ4FrameDecompressor().decompress(bytes(data), max_length=limit))
    except Exception as error:
        raise ValueError(f"a chunk cannot be decompressed: {error}") from error
    raise ValueError(f"compression {compression!r} is unknown")


def chunk_records(records: memoryview) -> Iterator[tuple[int, int, memoryview]]:
    """Yield opcode, offset and body of every record in a chunk or an index.

    Raises ValueError at a bad end, and for more than a recording can hold.
    """
    at = count = parsed_bytes = 0
    while at < len(records):
        opcode, length = RECORD_HEADER.unpack_from(records, at)
        end = at + RECORD_HEADER.size + length
        if end > len(records):
            raise ValueError("a record runs over the end of its chunk")
        count += 1
        if opcode not in _MANY:
            parsed_bytes += length
        if count > _MAX_RECORDS or parsed_bytes > _MAX_PARSED_BYTES:
            raise ValueError(f"{count} records with {parsed_bytes} bytes to parse are too many")
        yield opcode, at, records[at + RECORD_HEADER.size : end]
        at = end


def message_key(body: memoryview) -> tuple[int, int]:
    """Return the channel id and the log time of a message record."""
    channel, _, log_time_ns, _ = MESSAGE_HEADER.unpack_from(body)
    return channel, log_time_ns


def _messages(chunk: Chunk, topics: dict[int, str]) -> Iterator[Message]:
    small_bytes = 0
    for opcode, _, body in chunk_records(chunk.records):
        if opcode == Opcode.CHANNEL:
            channel = parse(opcode, body)
            topics[channel.id] = channel.topic
        elif opcode == Opcode.MESSAGE:
            id_, sequence, log_time_ns, _ = MESSAGE_HEADER.unpack_from(body)
            if id_ not in topics:
                raise ValueError(f"nothing says what the messages of channel {id_} are about")
            data = body[MESSAGE_HEADER.size :]
            if topics[id_] not in IMAGES:
                small_bytes += len(data)
            if small_bytes > _MAX_SMALL_BYTES:
                raise ValueError(f"a chunk holds over {_MAX_SMALL_BYTES} bytes beside its pictures")
            yield Message(topics[id_], sequence, log_time_ns, data)
