"""A recording made smaller for keeping: the same messages in compressed chunks."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import zstandard
from mcap.opcode import Opcode

from rig.core.errors import RecordingError
from rig.record import bag
from rig.record.cdr import Buffer
from rig.record.container import (
    CHUNK_HEADER,
    MAGIC,
    RECORD_HEADER,
    Chunk,
    Container,
    Extent,
    damage,
    read_chunk,
)
from rig.record.file import RecordingFile
from rig.record.index import Index
from rig.record.reader import Recording
from rig.record.scan import note_channels, places_of

LEVEL = 3
"""Of zstd: higher levels gain a few percent of sensor noise and cost several times as much."""

_RESERVE_BYTES = 1 << 20


def archive(recording: Recording, folder: Path, progress: Callable[[int], None]) -> Path:
    """Write the recording anew into `folder`, each chunk compressed by zstd.

    Every message stays as it is, byte for byte, so `rig verify` proves the archive as it proves
    the recording. Raises RecordingError when the folder exists or cannot be written; one that
    could not be ended is taken away.
    """
    try:
        folder.mkdir(parents=True)
        with _taken_away_unless_ended(folder):
            for part in recording.parts:
                _archive_part(part, folder / part.name, progress)
            bag.describe(folder / recording.path.name)
    except OSError as error:
        raise RecordingError(
            f"cannot write {folder}: {error.strerror}; name a new folder with --out"
        ) from error
    return folder


@contextmanager
def _taken_away_unless_ended(folder: Path) -> Iterator[None]:
    try:
        yield
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _archive_part(part: Path, out: Path, progress: Callable[[int], None]) -> None:
    file = RecordingFile(out, reserve_bytes=_RESERVE_BYTES, live=False)
    try:
        for end, pieces in _compressed_part(part, file.tell):
            file.write(pieces)
            progress(end)
    finally:
        file.close()


def _compressed_part(part: Path, tell: Callable[[], int]) -> Iterator[tuple[int, list[Buffer]]]:
    """Yield how far the part was read, and what is to be written next at `tell()`."""
    index, compressor = Index(), zstandard.ZstdCompressor(level=LEVEL)
    with damage(part), Container(part) as source:
        yield len(MAGIC), [MAGIC]
        for extent in source.extents():
            if extent.opcode == Opcode.DATA_END:
                break
            if extent.opcode == Opcode.CHUNK:
                yield extent.end, _chunk(source, extent, index, tell(), compressor)
            elif extent.opcode in (Opcode.HEADER, Opcode.ATTACHMENT, Opcode.METADATA):
                yield extent.end, _copy(source, extent, index, tell())
        yield source.size, [index.ending(tell())]


def _copy(source: Container, extent: Extent, index: Index, start: int) -> list[Buffer]:
    if extent.opcode == Opcode.ATTACHMENT:
        index.add_attachment(start, extent.size, source.parsed(extent))
    elif extent.opcode == Opcode.METADATA:
        index.add_metadata(start, extent.size, source.parsed(extent).name)
    header = RECORD_HEADER.pack(extent.opcode, extent.size - RECORD_HEADER.size)
    return [header, source.body(extent)]


def _chunk(
    source: Container,
    extent: Extent,
    index: Index,
    start: int,
    compressor: zstandard.ZstdCompressor,
) -> list[Buffer]:
    body = source.body(extent)
    chunk = read_chunk(body)
    if not chunk.crc_holds:
        raise ValueError(f"the checksum of the chunk at byte {extent.start} is wrong")
    note_channels(chunk.records, index)
    packed = compressor.compress(chunk.records)
    data = _compressed(chunk, _crc(body), packed)
    place = Extent(Opcode.CHUNK, start, len(data))
    sizes = (len(packed), len(chunk.records))
    times_ns = (chunk.start_time_ns, chunk.end_time_ns)
    following = index.add_chunk(place, times_ns, sizes, places_of(chunk), "zstd")
    return [data, following]


def _crc(body: bytearray) -> int:
    crc: int = CHUNK_HEADER.unpack_from(body)[3]
    return crc


def _compressed(chunk: Chunk, crc: int, packed: bytes) -> bytes:
    name = b"zstd"
    head = CHUNK_HEADER.pack(
        chunk.start_time_ns, chunk.end_time_ns, len(chunk.records), crc, len(name)
    )
    body = head + name + len(packed).to_bytes(8, "little") + packed
    return RECORD_HEADER.pack(Opcode.CHUNK, len(body)) + body
