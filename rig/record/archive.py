"""A recording made smaller for keeping: the same messages in compressed chunks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import zstandard
from mcap.opcode import Opcode

from rig.core.errors import RecordingError
from rig.record import bag
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
    the recording. Raises RecordingError when the folder exists or cannot be written.
    """
    try:
        folder.mkdir(parents=True)
        for part in recording.parts:
            with damage(part), Container(part) as source:
                _archive_part(source, folder / part.name, progress)
        bag.describe(folder / recording.path.name)
    except OSError as error:
        raise RecordingError(
            f"cannot write {folder}: {error.strerror}; name a new folder with --out"
        ) from error
    return folder


def _archive_part(source: Container, out: Path, progress: Callable[[int], None]) -> None:
    index, compressor = Index(), zstandard.ZstdCompressor(level=LEVEL)
    file = RecordingFile(out, reserve_bytes=_RESERVE_BYTES, live=False)
    try:
        file.write([MAGIC])
        for extent in source.extents():
            if extent.opcode == Opcode.DATA_END:
                break
            if extent.opcode == Opcode.CHUNK:
                _copy_chunk(source, extent, index, file, compressor)
            elif extent.opcode in (Opcode.HEADER, Opcode.ATTACHMENT, Opcode.METADATA):
                _copy(source, extent, index, file)
            progress(extent.end)
        file.write([index.ending(file.tell())])
    finally:
        file.close()


def _copy(source: Container, extent: Extent, index: Index, file: RecordingFile) -> None:
    start = file.tell()
    if extent.opcode == Opcode.ATTACHMENT:
        index.add_attachment(start, extent.size, source.parsed(extent))
    elif extent.opcode == Opcode.METADATA:
        index.add_metadata(start, extent.size, source.parsed(extent).name)
    header = RECORD_HEADER.pack(extent.opcode, extent.size - RECORD_HEADER.size)
    file.write([header, source.body(extent)])


def _copy_chunk(
    source: Container,
    extent: Extent,
    index: Index,
    file: RecordingFile,
    compressor: zstandard.ZstdCompressor,
) -> None:
    body = source.body(extent)
    chunk = read_chunk(body)
    if not chunk.crc_holds:
        raise ValueError(f"the checksum of the chunk at byte {extent.start} is wrong")
    note_channels(chunk, index)
    packed = compressor.compress(chunk.records)
    data = _compressed(chunk, _crc(body), packed)
    place = Extent(Opcode.CHUNK, file.tell(), len(data))
    sizes = (len(packed), len(chunk.records))
    times_ns = (chunk.start_time_ns, chunk.end_time_ns)
    following = index.add_chunk(place, times_ns, sizes, places_of(chunk), "zstd")
    file.write([data, following])


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
