"""Any frame at once, without reading the file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from mcap.opcode import Opcode
from record_disk import RealOs
from record_samples import assert_same, half, neither, record, write

from rig.core.errors import RecordingDamaged, UsageError
from rig.core.types import SIDES, Frame, PairRecord
from rig.record import container, sink
from rig.record.container import RECORD_HEADER, Container
from rig.record.frames import Frames
from rig.record.index import Index
from rig.record.scan import Scan

RECORDS = [record(0), half(1), neither(2), *(record(t) for t in range(3, 40))]


def shots(frames: Frames, expected: list[PairRecord], order: Sequence[int]) -> None:
    for trigger in order:
        given = expected[trigger]
        found = given.shot._replace(**{side: frames.frame(trigger, side) for side in SIDES})
        assert_same(type(given)(**{**fields(given), "shot": found}), given)


def fields(given: PairRecord) -> dict[str, object]:
    return {name: getattr(given, name) for name in PairRecord.__slots__}


@pytest.mark.parametrize("part_bytes", [1 << 30, 20_000])
@pytest.mark.parametrize("chunk_bytes", [1, 5_000, 1 << 20])
def test_frames_in_any_order_are_those_recorded(
    tmp_path: Path, part_bytes: int, chunk_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sink, "PART_BYTES", part_bytes)
    monkeypatch.setattr(sink, "CHUNK_BYTES", chunk_bytes)
    write(tmp_path, RECORDS)
    order = np.random.default_rng(0).permutation(len(RECORDS)).tolist()
    with Frames(tmp_path) as frames:
        assert len(frames) == len(RECORDS)
        shots(frames, RECORDS, order)
        for wrong in (-1, len(RECORDS)):
            with pytest.raises(UsageError, match=f"no trigger {wrong}, it has {len(RECORDS)}"):
                frames.frame(wrong, "primary")


class Bounded(RealOs):
    """Fails on a read of more than `most` bytes, and counts all."""

    def __init__(self, most: int) -> None:
        self.most = most
        self.total = 0

    def pread(self, fd: int, size: int, start: int) -> bytes:
        self._count(size)
        return os.pread(fd, size, start)

    def preadv(self, fd: int, buffers: Sequence[bytearray], start: int) -> int:
        self._count(sum(map(len, buffers)))
        return os.preadv(fd, buffers, start)

    def _count(self, size: int) -> None:
        if size > self.most:
            raise AssertionError(f"{size} bytes were read at once")
        self.total += size


def test_no_read_is_longer_than_an_index_or_a_chunk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sink, "CHUNK_BYTES", 1)
    size = write(tmp_path, [record(t) for t in range(300)]).stat().st_size
    bounded = Bounded(most=100_000)
    monkeypatch.setattr(container, "os", bounded)
    with Frames(tmp_path) as frames:
        opened = bounded.total
        for trigger in (7, 150, 299):
            assert isinstance(frames.frame(trigger, "secondary"), Frame)
    assert opened < size / 3
    assert bounded.total - opened < 3 * 6_000
    for number, found in enumerate(frames.recording.records()):
        assert found.trigger == number


def sparse(path: Path, hole_bytes: int) -> None:
    """Put a hole, which readers skip as a private record, behind the first chunk of a file."""
    data = path.read_bytes()
    with Container(path) as source:
        chunks = [each for each in source.extents() if each.opcode == Opcode.CHUNK]
    middle = chunks[1].start
    with path.open("r+b") as file:
        file.truncate(middle)
        file.seek(middle)
        file.write(RECORD_HEADER.pack(0x80, hole_bytes - RECORD_HEADER.size))
        file.seek(middle + hole_bytes)
        file.write(data[middle:])
    with Container(path) as source:
        scan = Scan(source)
        scan.run()
        index: Index = scan.index
        ending = index.ending(scan.end)
    with path.open("r+b") as file:
        for start, patch in scan.patches:
            file.seek(start)
            file.write(patch)
        file.truncate(scan.end)
        file.seek(scan.end)
        file.write(ending)


def test_a_huge_sparse_file_opens_in_a_moment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sink, "CHUNK_BYTES", 1)
    path = write(tmp_path, RECORDS)
    sparse(path, 200 << 30)
    assert path.stat().st_size > 200 << 30
    bounded = Bounded(most=100_000)
    monkeypatch.setattr(container, "os", bounded)
    with Frames(tmp_path) as frames:
        shots(frames, RECORDS, [39, 0, 20])
    assert bounded.total < 400_000


def test_a_changed_pixel_is_found(tmp_path: Path) -> None:
    path = write(tmp_path, RECORDS)
    data = bytearray(path.read_bytes())
    first = record(5).shot.primary
    assert isinstance(first, Frame)
    data[data.index(first.image.tobytes()) + 100] ^= 1
    path.write_bytes(data)
    with Frames(tmp_path) as frames:
        with pytest.raises(RecordingDamaged, match="primary picture of trigger 5 is not the one"):
            frames.frame(5, "primary")
        assert isinstance(frames.frame(5, "secondary"), Frame)
