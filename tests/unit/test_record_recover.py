"""A cut recording is repaired or refused in one line, whatever the cut."""

from __future__ import annotations

import errno
import os
import zlib
from pathlib import Path
from typing import Any

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from record_samples import assert_same, half, record, write

from rig.core.errors import RecordingDamaged, RecordingError
from rig.drivers.registry import open_source
from rig.pair import CameraPair
from rig.record import sink
from rig.record.container import Container
from rig.record.info import info
from rig.record.reader import open_recording
from rig.record.recover import _rewrite, recover
from rig.record.verify import verify

RECORDS = [record(0), half(1), record(2), record(3)]


@pytest.fixture(autouse=True)
def chunk_per_trigger(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small pictures would share a chunk; large ones never do."""
    monkeypatch.setattr(sink, "CHUNK_BYTES", 1)


@pytest.fixture
def whole(tmp_path: Path) -> bytes:
    return write(tmp_path / "whole", RECORDS).read_bytes()


def spoil_chunk(tmp_path: Path, whole: bytes, number: int) -> bytearray:
    with Container(tmp_path / "whole" / "run.mcap") as container:
        chunks = [e for e in container.extents() if e.opcode == Opcode.CHUNK]
    data = bytearray(whole)
    data[chunks[number].end - 1] ^= 0xFF
    return data


def boundaries(path: Path) -> list[tuple[int, int]]:
    with Container(path) as container:
        return [(extent.opcode, extent.end) for extent in container.extents()]


def assert_doctor_clean(path: Path) -> None:
    """Let the official reader go through everything and check what the index says."""
    with path.open("rb") as file:
        streamed = [type(r).__name__ for r in StreamReader(file, validate_crcs=True).records]
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        indexed = [message for _, _, message in reader.iter_messages(log_time_order=False)]
        assert len(indexed) == streamed.count("Message") == summary.statistics.message_count
        assert len(summary.chunk_indexes) == summary.statistics.chunk_count
        assert len(list(reader.iter_metadata())) == summary.statistics.metadata_count
        assert len(list(reader.iter_attachments())) == summary.statistics.attachment_count
        for chunk in summary.chunk_indexes:
            for id_, offset in chunk.message_index_offsets.items():
                file.seek(offset)
                assert file.read(1)[0] == Opcode.MESSAGE_INDEX
                assert id_ in summary.channels


def test_an_intact_recording_is_left_alone(tmp_path: Path, whole: bytes) -> None:
    file = tmp_path / "whole" / "run.mcap"
    found = recover(file)
    assert not found.repaired
    assert (found.triggers, found.dropped_bytes, found.skipped_chunks) == (4, 0, 0)
    assert file.read_bytes() == whole


def test_a_cut_in_the_index_gives_the_same_file_again(tmp_path: Path, whole: bytes) -> None:
    data_end = next(
        end for op, end in boundaries(tmp_path / "whole" / "run.mcap") if op == Opcode.DATA_END
    )
    file = tmp_path / "run.mcap"
    for size in range(data_end - 13, len(whole), 137):
        file.write_bytes(whole[:size])
        assert recover(file).triggers == 4
        assert file.read_bytes() == whole


def cuts(size: int, ends: list[int]) -> list[int]:
    near = {end + step for end in ends for step in (-1, 0, 1, 9)}
    return sorted((near | set(range(0, size, 997))) & set(range(size)))


def test_a_cut_anywhere_is_repaired_or_refused(tmp_path: Path, whole: bytes) -> None:
    ends = boundaries(tmp_path / "whole" / "run.mcap")
    chunk_ends = [end for opcode, end in ends if opcode == Opcode.CHUNK]
    file = tmp_path / "run.mcap"
    refused = 0
    for size in cuts(len(whole), [end for _, end in ends]):
        file.write_bytes(whole[:size])
        with pytest.raises(RecordingDamaged):
            open_recording(file)
        try:
            found = recover(file)
        except RecordingDamaged as error:
            refused += 1
            assert "\n" not in str(error)
            assert file.read_bytes() == whole[:size]
            assert not any(end <= size for end in chunk_ends)
            continue
        expected = sum(end <= size for end in chunk_ends)
        assert found.triggers == expected
        records = list(open_recording(file).records())
        for a, b in zip(records, RECORDS[:expected], strict=True):
            assert_same(a, b)
        assert verify(file).sound
        assert not recover(file).repaired
        assert_doctor_clean(file)
    assert refused > 0


def test_a_recovered_recording_says_so(tmp_path: Path, whole: bytes) -> None:
    file = tmp_path / "run.mcap"
    file.write_bytes(whole[: len(whole) // 2])
    recover(file)
    assert info(file).recovered
    assert (tmp_path / "metadata.yaml").exists()


def test_room_kept_back_by_a_killed_run_is_given_back(tmp_path: Path, whole: bytes) -> None:
    file = tmp_path / "run.mcap"
    file.write_bytes(whole[:-50])
    reserve = tmp_path / "run.mcap.reserve"
    reserve.write_bytes(bytes(1000))
    recover(file)
    assert not reserve.exists()


def test_a_full_disk_has_room_for_the_index_where_the_reserve_lies(
    tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, reserve = tmp_path / "run.mcap", tmp_path / "run.mcap.reserve"
    file.write_bytes(whole[:-50])
    reserve.write_bytes(bytes(1000))

    def fill_up(path: Path, *what: Any) -> None:
        if reserve.stat().st_size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        _rewrite(path, *what)

    monkeypatch.setattr("rig.record.recover._rewrite", fill_up)
    assert recover(file).repaired
    assert verify(file).sound


def test_a_repair_without_room_says_how_to_go_on(
    tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, reserve = tmp_path / "run.mcap", tmp_path / "run.mcap.reserve"
    file.write_bytes(whole[:-50])
    reserve.write_bytes(bytes(1000))

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("rig.record.recover._rewrite", full)
    with pytest.raises(RecordingError, match=f"No space left.*run: rig recover {file}"):
        recover(file)
    assert reserve.exists()  # the next run tries it again


def test_a_tail_of_zeros_after_lost_power_is_dropped(tmp_path: Path, whole: bytes) -> None:
    file = tmp_path / "run.mcap"
    size = len(whole) // 2
    file.write_bytes(whole[:size] + bytes(50_000_000))
    assert recover(file).triggers > 0
    assert verify(file).sound


def test_a_corrupt_chunk_in_the_middle_is_hidden_and_reported(tmp_path: Path, whole: bytes) -> None:
    file = tmp_path / "run.mcap"
    file.write_bytes(spoil_chunk(tmp_path, whole, 1))
    with pytest.raises(RecordingDamaged, match="checksum"):
        list(open_recording(file).records())
    found = recover(file)
    assert (found.skipped_chunks, found.triggers) == (1, 3)
    assert [r.trigger for r in open_recording(file).records()] == [0, 2, 3]
    assert_doctor_clean(file)
    assert any("trigger 2: follows trigger 0" in each for each in verify(file).false_claims)
    assert not recover(file).repaired


def test_a_corrupt_first_chunk_takes_no_other_with_it(tmp_path: Path, whole: bytes) -> None:
    """The first one alone says which topic a channel is."""
    file = tmp_path / "run.mcap"
    file.write_bytes(spoil_chunk(tmp_path, whole, 0))
    found = recover(file)
    assert (found.skipped_chunks, found.triggers) == (1, 3)
    assert [r.trigger for r in open_recording(file).records()] == [1, 2, 3]
    assert_doctor_clean(file)
    assert not recover(file).repaired


def test_a_corrupt_first_chunk_without_an_index_is_refused_unchanged(tmp_path: Path) -> None:
    """The others lie more than two seconds behind it: a crash does not leave that."""
    whole = write(tmp_path / "whole", [record(trigger) for trigger in range(40)]).read_bytes()
    file = tmp_path / "run.mcap"
    file.write_bytes(spoil_chunk(tmp_path, whole, 0)[:-50])
    before = file.read_bytes()
    with pytest.raises(RecordingDamaged, match="lost its first chunk, which names the topics"):
        recover(file)
    assert file.read_bytes() == before


def test_pairs_behind_a_hidden_chunk_are_replayed(tmp_path: Path, whole: bytes) -> None:
    file = tmp_path / "run.mcap"
    file.write_bytes(spoil_chunk(tmp_path, whole, 1))
    recover(file)
    pair = CameraPair(open_source(f"replay:{tmp_path}", seed=0))
    shots = [pair.shoot() for _ in range(3)]
    assert [shot.cause for shot in shots] == ["", "", ""]
    assert [shot.frames.primary.sequence for shot in shots] == [0, 1, 2]


def test_more_than_a_cut_is_refused_unchanged(tmp_path: Path, whole: bytes) -> None:
    file = tmp_path / "run.mcap"
    data = whole[: len(whole) // 2] + zlib.crc32(whole).to_bytes(4, "big") * 10_000_000
    file.write_bytes(data)
    with pytest.raises(RecordingDamaged, match="more than a cut leaves; nothing was changed"):
        recover(file)
    assert file.read_bytes() == data


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="does not exist"):
        recover(tmp_path / "none")
    text = tmp_path / "text.mcap"
    text.write_text("hello")
    with pytest.raises(RecordingDamaged, match="no MCAP file"):
        recover(text)
    assert text.read_text() == "hello"
