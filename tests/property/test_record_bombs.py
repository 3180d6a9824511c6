"""Files made to do harm: one line, within 2 s of work and 256 MB, through the commands."""

from __future__ import annotations

import json
import random
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Footer,
    MetadataIndex,
    Statistics,
)
from record_samples import record, write

from rig.core.errors import RigError
from rig.core.types import Settings
from rig.record import codec, topics
from rig.record.container import MAGIC, RECORD_HEADER, Container
from rig.record.frames import Frames
from rig.record.info import info
from rig.record.reader import open_recording
from rig.record.recover import recover
from rig.record.scan import Scan
from rig.record.verify import verify

RUNNER = """
import json, resource, sys, time
from rig.core.errors import RigError
from rig.core.types import Settings
from rig.record import codec, topics
from rig.record.frames import Frames
from rig.record.info import info
from rig.record.reader import open_recording
from rig.record.recover import recover
from rig.record.verify import verify
def frames(path):
    with Frames(path) as found:
        for trigger in range(len(found)):
            found.frame(trigger, "primary")
def proof(path):
    found = verify(path)
    if not found.sound:
        raise RigError(f"{path} is not sound: {found.false_claims[0]}")
def records(path):
    return sum(1 for _ in open_recording(path).records())
work = {"records": records, "verify": proof, "info": info, "frames": frames, "recover": recover}
base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
said = {}
for name, each in work.items():
    started = time.process_time()
    try:
        each(sys.argv[1])
        said[name] = ""
    except RigError as error:
        said[name] = str(error)
    said[name + " s"] = time.process_time() - started
said["mb"] = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base) / 1024
print(json.dumps(said))
"""


def packed(*records: object) -> bytes:
    builder = RecordBuilder()
    for each in records:
        each.write(builder)  # type: ignore[attr-defined]
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def rewritten(whole: bytes, path: Path, chunk: bytes, *, with_end: bool = True) -> bytes:
    """Return a file with its chunk exchanged, so that readers meet it, or recovery at a cut."""
    path.write_bytes(whole)
    with Container(path) as source:
        (extent,) = [each for each in source.extents() if each.opcode == Opcode.CHUNK]
        scan = Scan(source)
        scan.run()
    index = scan.index
    index.metadata = [each for each in index.metadata if each.offset < extent.start]
    data = whole[: extent.start] + RECORD_HEADER.pack(Opcode.CHUNK, len(chunk)) + chunk
    return data + index.ending(len(data)) if with_end else data


def ended(data: bytes, summary: bytes) -> bytes:
    start = len(data)
    footer = packed(Footer(summary_start=start, summary_offset_start=0, summary_crc=0))[:-4]
    return data + summary + footer + zlib.crc32(summary + footer).to_bytes(4, "little") + MAGIC


def chunk_of(name: bytes, stored: bytes, size: int) -> bytes:
    head = (0).to_bytes(16, "little") + size.to_bytes(8, "little") + bytes(4)
    return (
        head + len(name).to_bytes(4, "little") + name + len(stored).to_bytes(8, "little") + stored
    )


BOMB = bytes(1 << 30)


def zstd_bomb() -> bytes:
    return zstandard.ZstdCompressor(level=1).compress(BOMB)


def lz4_bomb() -> bytes:
    packed_: bytes = lz4.frame.compress(BOMB[: 256 << 20])
    return packed_


def statistics() -> Statistics:
    return Statistics(0, 0, {}, 0, 0, 0, 0, 0, 0)


def zstd_chunk(records: bytes) -> bytes:
    """Return an honest chunk, whatever the records are."""
    size = len(records)
    return chunk_of(b"zstd", zstandard.ZstdCompressor(level=1).compress(records), size)


def messages(size: int, count: int, topic: str) -> bytes:
    """Return `count` messages of `size` bytes on a topic of their own channel."""
    told = Channel(id=1, topic=topic, message_encoding="cdr", metadata={}, schema_id=0)
    each = RECORD_HEADER.pack(Opcode.MESSAGE, 22 + size) + (1).to_bytes(2, "little")
    return packed(told) + (each + bytes(20 + size)) * count


def many_thoughts() -> bytes:
    """Return a decision with two million things that a controller was thinking."""
    body = topics.DECISION_TYPE.pack(thoughts(()))[:-4] + (2_000_000).to_bytes(4, "little")
    body += bytes(24) * 2_000_000
    told = packed(
        Channel(id=1, topic="/primary/decision", message_encoding="cdr", metadata={}, schema_id=0)
    )
    head = (1).to_bytes(2, "little") + bytes(20)
    return told + RECORD_HEADER.pack(Opcode.MESSAGE, len(head) + len(body)) + head + body


def thoughts(found: tuple[object, ...]) -> dict[str, object]:
    stamp = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    settings = {"exposure_us": 1.0, "gain_db": 0.0}
    return {
        "header": stamp,
        "trigger": 0,
        "controller": "",
        "command": {**codec._command(Settings(1.0, 0.0)), "settings": settings},
        "latency_ms": 0.0,
        "diagnostics": list(found),
    }


def wide_metadata() -> bytes:
    """Return a metadata record of 16 MB with a million small values, as the run's own."""
    value = (4).to_bytes(4, "little") + b"%04d" + (0).to_bytes(4, "little")
    values = b"".join(value % (n % 10_000) for n in range(1_300_000))
    name = b"rig.run"
    body = len(name).to_bytes(4, "little") + name + len(values).to_bytes(4, "little") + values
    return RECORD_HEADER.pack(Opcode.METADATA, len(body)) + body


def wide_statistics() -> bytes:
    """Return statistics of five million channels."""
    counts = b"".join(n.to_bytes(2, "little") + bytes(8) for n in range(1 << 16)) * 80
    body = bytes(42) + len(counts).to_bytes(4, "little") + counts
    return RECORD_HEADER.pack(Opcode.STATISTICS, len(body)) + body


def same_attachment(data: bytes) -> bytes:
    """Return a file with one attachment of 15 MB that its index names ten thousand times."""
    attachment = packed(Attachment(0, 0, "options.json", "", bytes(15 << 20)))
    entry = packed(AttachmentIndex(len(data), len(attachment), 0, 0, 15 << 20, "options.json", ""))
    return ended(data + attachment, entry * 10_000 + packed(statistics()))


def same_chunk(data: bytes) -> bytes:
    """Return a file whose index names one message index fifty thousand times."""
    told = [
        Channel(id=n, topic=topic, message_encoding="cdr", metadata={}, schema_id=0)
        for n, topic in enumerate(["/pair", "/primary/frame_meta", "/secondary/frame_meta"])
    ]
    start = len(data)
    index = RECORD_HEADER.pack(Opcode.MESSAGE_INDEX, 6 + 800_000) + (0).to_bytes(2, "little")
    index += (800_000).to_bytes(4, "little") + bytes(800_000)
    chunk = packed(
        ChunkIndex(
            chunk_length=9,
            chunk_start_offset=9,
            compression="",
            compressed_size=0,
            message_end_time=0,
            message_index_length=0,
            message_index_offsets={0: start, 1: start, 2: start},
            message_start_time=0,
            uncompressed_size=0,
        )
    )
    return ended(data + index, packed(*told) + chunk * 50_000 + packed(statistics()))


BOMBS: dict[str, Callable[[bytes, Path], bytes]] = {
    "zstd, honest size": lambda w, p: rewritten(w, p, chunk_of(b"zstd", zstd_bomb(), 1 << 30)),
    "zstd, no end": lambda w, p: rewritten(
        w, p, chunk_of(b"zstd", zstd_bomb(), 64 << 20), with_end=False
    ),
    "zstd, small size": lambda w, p: rewritten(w, p, chunk_of(b"zstd", zstd_bomb(), 1_000)),
    "zstd, largest size": lambda w, p: rewritten(w, p, chunk_of(b"zstd", zstd_bomb(), 64 << 20)),
    "lz4, small size": lambda w, p: rewritten(w, p, chunk_of(b"lz4", lz4_bomb(), 1_000)),
    "lz4, largest size": lambda w, p: rewritten(w, p, chunk_of(b"lz4", lz4_bomb(), 64 << 20)),
    "a record of 2^62 bytes": lambda w, _: w[:8] + RECORD_HEADER.pack(1, 1 << 62) + w[17:],
    "an index of 100,000 entries": lambda w, _: ended(
        w[:400], packed(*[MetadataIndex(0, 9, "x")] * 100_000, statistics())
    ),
    "half a million chunks in the index": lambda w, _: ended(
        w[:400],
        packed(
            ChunkIndex(
                chunk_length=9,
                chunk_start_offset=9,
                compression="",
                compressed_size=0,
                message_end_time=0,
                message_index_length=0,
                message_index_offsets={},
                message_start_time=0,
                uncompressed_size=0,
            )
        )
        * 500_000
        + packed(statistics()),
    ),
    "seven million empty records in a chunk": lambda w, p: rewritten(
        w, p, zstd_chunk(RECORD_HEADER.pack(0x81, 0) * (7 << 20))
    ),
    "two million empty messages in a chunk": lambda w, p: rewritten(
        w, p, zstd_chunk(messages(0, 2 << 20, "/primary/camera_info"))
    ),
    "sixty thousand small messages in a chunk": lambda w, p: rewritten(
        w, p, zstd_chunk(messages(900, 60_000, "/primary/camera_info"))
    ),
    "a decision with two million thoughts": lambda w, p: rewritten(
        w, p, zstd_chunk(many_thoughts())
    ),
    "channels of sixteen megabytes": lambda w, p: rewritten(
        w, p, zstd_chunk(wide_metadata().replace(b"\x0c", b"\x04", 1) * 3)
    ),
    "metadata with a million values": lambda w, _: ended(
        w[:8] + wide_metadata(), packed(MetadataIndex(8, 1, "rig.run"), statistics())
    ),
    "statistics of five million channels": lambda w, _: ended(w[:400], wide_statistics()),
    "one attachment, ten thousand times": lambda w, _: same_attachment(w[:400]),
    "one message index, fifty thousand times": lambda w, _: same_chunk(w[:400]),
    "a million empty records": lambda w, _: w[:400] + RECORD_HEADER.pack(0x81, 0) * 1_000_000,
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("whole")
    return write(folder, [record(t) for t in range(3)]).read_bytes()


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_costs_little_and_ends_in_one_line(tmp_path: Path, whole: bytes, name: str) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(BOMBS[name](whole, path))
    done = subprocess.run(
        [sys.executable, "-c", RUNNER, str(path)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["mb"] < 256
    for work in ("records", "verify", "info", "frames", "recover"):
        assert said[f"{work} s"] < 2.0, said
        assert "\n" not in said[work]
        if work in ("records", "verify"):
            assert str(path) in said[work], said


def damaged(whole: bytes, seed: int) -> bytes:
    """Return the file with bytes changed, cut out, doubled or exchanged."""
    draw = random.Random(seed)
    data = bytearray(whole)
    for _ in range(draw.randint(1, 4)):
        start = draw.randrange(len(data))
        end = min(len(data), start + draw.choice([1, 2, 8, 64, 1_000]))
        kind = draw.randrange(5)
        if kind == 0:
            data[start:end] = draw.randbytes(end - start)
        elif kind == 1:
            del data[start:end]
        elif kind == 2:
            data[start:start] = data[start:end]
        elif kind == 3:
            data[start:end] = b"\xff" * (end - start)
        else:
            data[start:end] = bytes(end - start)
    return bytes(data)


def all_frames(path: Path) -> None:
    with Frames(path) as frames:
        for trigger in range(len(frames)):
            frames.frame(trigger, "secondary")


@pytest.mark.parametrize(
    "seeds", [range(250), pytest.param(range(250, 20_000), marks=pytest.mark.heavy)]
)
def test_the_corpus_of_damaged_files_gives_the_records_or_a_rig_error(
    tmp_path: Path, whole: bytes, seeds: range
) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(whole)
    expected = [each.trigger for each in open_recording(path).records()]
    for seed in seeds:
        path.write_bytes(damaged(whole, seed))
        for work in (verify, info, all_frames, recover, verify):
            try:
                work(path)
            except RigError as error:
                assert "\n" not in str(error), seed
        path.write_bytes(damaged(whole, seed))
        try:
            recording = open_recording(path)
            found = [each.trigger for each in recording.records()]
        except RigError:
            continue
        assert len(recording) == len(found), seed
        assert found == expected or not verify(path).sound, seed
