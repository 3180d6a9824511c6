"""Whatever bytes a file holds: the right records, or one clear error."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import lz4.frame
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from record_samples import AUTO, DECISION, HEADER, assert_same, frame, half, record, write

from rig.core.errors import RecordingDamaged, RigError
from rig.core.types import Auto, Decision, Limits, Lost, Pair, PairRecord, Settings, Truth
from rig.record import codec
from rig.record.container import MAGIC, RECORD_HEADER, Container, inflate
from rig.record.reader import open_recording
from rig.record.recover import recover
from rig.record.verify import verify

RECORDS = [record(0), half(1), record(2)]


@cache
def whole() -> bytes:
    with TemporaryDirectory() as folder:
        return write(Path(folder), RECORDS).read_bytes()


texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
causes = texts.filter(bool)
finite = st.floats(allow_nan=False, allow_infinity=False)
some_settings = st.builds(Settings, st.floats(1e-3, 1e9, exclude_min=True), st.floats(0.0, 1e3))
ranges = st.tuples(st.floats(1.0, 100.0), st.floats(100.0, 1e6))
autos = st.builds(
    Auto,
    st.builds(Limits, ranges, ranges),
    st.floats(0.0, 255.0),
    st.floats(0.0, 0.99),
    some_settings,
)
commands = some_settings | autos
decisions = st.builds(
    Decision, texts, commands, finite, st.dictionaries(texts, finite | texts, max_size=4)
)
truths = st.builds(Truth, st.tuples(*[finite] * 3), st.tuples(*[finite] * 4), finite)
shots = st.builds(lambda used: replace(frame(0), used=used), some_settings) | st.builds(
    Lost, st.integers(-(2**63), 2**63 - 1), causes
)
pair_records = st.builds(
    PairRecord,
    trigger=st.just(0),
    pose_index=st.integers(-(2**63), 2**63 - 1),
    asked=st.builds(Pair, commands, commands),
    applied=st.builds(Pair, commands, commands),
    shot=st.builds(Pair, shots, shots),
    decisions=st.builds(Pair, st.none() | decisions, st.none() | decisions),
    offset_ns=st.none() | st.integers(-(2**63), 2**63 - 1),
    cause=texts,
    truth=st.none() | truths,
)


@given(pair_records)
def test_every_record_comes_back(expected: PairRecord) -> None:
    messages, _ = codec.encode(expected, codec.Tie())
    assert_same(codec.decode({each.topic: each.joined() for each in messages}), expected)


def read_all(path: Path) -> list[PairRecord]:
    recording = open_recording(path)
    assert recording.header == HEADER
    return list(recording.records())


flips = st.lists(
    st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=3
)


@settings(max_examples=300, deadline=None)
@given(flips)
def test_changed_bytes_give_the_same_records_or_one_error(changes: list[tuple[float, int]]) -> None:
    data = bytearray(whole())
    for where, mask in changes:
        data[int(where * len(data))] ^= mask
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        path.write_bytes(data)
        try:
            for found, expected in zip(read_all(path), RECORDS, strict=True):
                assert_same(found, expected)
        except RigError as error:
            assert "\n" not in str(error)
        for work in (verify, recover):
            try:
                work(path)
            except RigError as error:
                assert "\n" not in str(error)


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=300), st.booleans())
def test_any_bytes_are_refused(data: bytes, has_magic: bool) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        path.write_bytes((MAGIC if has_magic else b"") + data)
        for work in (open_recording, verify, recover):
            with pytest.raises(RigError):
                work(path)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(st.data())
def test_changed_messages_decode_or_raise_what_the_reader_catches(data: st.DataObject) -> None:
    encoded, _ = codec.encode(record(0), codec.Tie())
    messages = [message.joined() for message in encoded]
    chosen = data.draw(st.sampled_from(range(len(messages))))
    body = bytearray(messages[chosen].data)
    for _ in range(data.draw(st.integers(1, 4))):
        body[data.draw(st.integers(0, len(body) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(body)))
    messages[chosen] = replace(messages[chosen], data=bytes(body[:cut]))
    with suppress(KeyError, ValueError, struct.error):
        codec.decode({message.topic: message for message in messages})


def compress(data: bytes, how: str) -> bytes:
    if how == "zstd":
        return zstandard.ZstdCompressor().compress(data)
    compressed: bytes = lz4.frame.compress(data)
    return compressed


def rewrite_chunk(data: bytes, how: str, claimed: int | None, plain: bytes | None) -> bytes:
    """Return the file with its one chunk compressed, its lengths as claimed."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        path.write_bytes(data)
        with Container(path) as container:
            (extent,) = [e for e in container.extents() if e.opcode == Opcode.CHUNK]
    body = data[extent.start + RECORD_HEADER.size : extent.end]
    start_ns, end_ns, size, crc, _ = struct.unpack_from("<QQQII", body)
    records = body[40:] if plain is None else plain
    stored = compress(records, how)
    size = size if claimed is None else claimed
    crc = crc if plain is None else zlib.crc32(plain)
    head = struct.pack("<QQQII", start_ns, end_ns, size, crc, len(how)) + how.encode()
    chunk = head + struct.pack("<Q", len(stored)) + stored
    return (
        data[: extent.start]
        + RECORD_HEADER.pack(Opcode.CHUNK, len(chunk))
        + chunk
        + data[extent.end :]
    )


@pytest.mark.parametrize("how", ["zstd", "lz4"])
def test_compressed_chunks_are_read(tmp_path: Path, how: str) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(rewrite_chunk(whole(), how, None, None))
    with Container(path) as container:
        messages = list(container.messages())
    path.write_bytes(whole())
    with Container(path) as container:
        expected = list(container.messages())
    assert [(m.topic, bytes(m.data)) for m in messages] == [
        (m.topic, bytes(m.data)) for m in expected
    ]


@pytest.mark.parametrize("how", ["zstd", "lz4"])
@pytest.mark.parametrize("claimed", [1_000, 2**40])
def test_a_bomb_is_refused_without_taking_memory(how: str, claimed: int) -> None:
    bomb = memoryview(compress(bytes(300 << 20), how))
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"claims|over"):
        inflate(bomb, how, claimed)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 16 << 20


@pytest.mark.parametrize("how", ["zstd", "lz4", "gzip"])
def test_rubbish_is_not_decompressed(how: str) -> None:
    with pytest.raises(ValueError, match=r"decompressed|unknown"):
        inflate(memoryview(b"rubbish" * 9), how, 63)


def test_a_record_that_claims_too_much_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    data = bytearray(whole())
    data[9:17] = (2**62).to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(RecordingDamaged):
        read_all(path)


def test_samples_cover_auto_and_diagnostics() -> None:
    assert record(0).asked.secondary == AUTO
    assert DECISION.diagnostics
