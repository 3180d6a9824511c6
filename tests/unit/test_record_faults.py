"""Every fault of a disk, a process or the power: what was written is kept, or said to be lost."""

from __future__ import annotations

import errno
import json
import os
import random
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_disk import CALLS, Fails, Journal, RealOs, ShortWrites, once
from record_samples import HEADER, INTRINSICS, assert_same, half, record, write

from rig.core.errors import RecordingDamaged, RecordingError
from rig.core.types import Pair, PairRecord
from rig.record import backing, sink, topics
from rig.record import file as file_module
from rig.record.container import Container, parts
from rig.record.file import RecordingFile
from rig.record.reader import open_recording
from rig.record.recover import recover, repair_left_behind
from rig.record.sink import Sink
from rig.record.verify import verify
from rig.record.writer import Expected, RecordWriter

RECORDS = [record(t) for t in range(6)]
PART_BYTES = 60_000


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """A chunk a trigger, and little room kept back."""
    monkeypatch.setattr(sink, "CHUNK_BYTES", 1)
    monkeypatch.setattr(sink, "_RESERVE_BYTES", 100_000)


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sink, "PART_BYTES", PART_BYTES)


def use_disk(monkeypatch: pytest.MonkeyPatch, disk: object) -> None:
    for module in (backing, file_module):
        monkeypatch.setattr(module, "os", disk)


def write_live(folder: Path, records: list[Any]) -> None:
    with RecordWriter(folder, HEADER, real_time=True) as writer:
        for each in records:
            writer.write(each)


def write_either(folder: Path, way: str) -> None:
    (write_live if way == "live" else write)(folder, RECORDS)


def heavy(value: object) -> Any:
    """Return a parameter for thorough test runs only."""
    return pytest.param(value, marks=pytest.mark.heavy)


def fast_and_heavy(fast: int, all_: int) -> list[Any]:
    """Return the first seeds for every test run, the others for a thorough one."""
    return [range(fast), heavy(range(fast, all_))]


WAYS = pytest.mark.parametrize("way", ["live", "simulated"])


@WAYS
@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_at_any_write_loses_pictures_and_says_so(
    tmp_path: Path, way: str, error: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for at in range(100):
        folder, disk = tmp_path / str(at), Fails(once(at), error)
        with monkeypatch.context() as patched:
            use_disk(patched, disk)
            try:
                write_either(folder, way)
            except RecordingError as problem:
                assert "disk is full" in str(problem)
        found = verify(folder)
        assert found.sound, (at, found.false_claims)
        assert found.pairs + sum(found.lost.values()) == len(RECORDS)
        assert list(folder.glob("*.reserve")) == []
        if disk.count <= at:
            return
    pytest.fail("the last write was never reached")


@WAYS
@pytest.mark.parametrize("error", [errno.EIO, errno.EFBIG])
def test_a_broken_disk_at_any_write_keeps_what_was_written(
    tmp_path: Path, way: str, error: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for at in range(100):
        folder, disk = tmp_path / str(at), Fails(once(at), error)
        with monkeypatch.context() as patched:
            use_disk(patched, disk)
            try:
                write_either(folder, way)
            except RecordingError as problem:
                assert "\n" not in str(problem)
                if at < 10 and "cannot create" in str(problem):
                    continue
        if disk.count <= at:
            assert verify(folder).pairs == len(RECORDS)
            return
        found = verify(folder)
        assert found.sound, (at, found.false_claims)
        for each in open_recording(folder).records():
            assert_same(each, RECORDS[each.trigger])
    pytest.fail("the last write was never reached")


ERRORS = (errno.ENOSPC, errno.EIO)


@pytest.mark.parametrize(
    ("way", "error", "part_bytes"),
    [
        ("live", errno.ENOSPC, 30_000),
        ("live", errno.EIO, 30_000),
        *(
            pytest.param(way, error, part_bytes, marks=pytest.mark.heavy)
            for way in ("live", "simulated")
            for error in (*ERRORS, errno.EDQUOT, errno.EFBIG)
            for part_bytes in (20_000, 1 << 30)
        ),
    ],
)
def test_a_call_that_fails_anywhere_leaves_a_sound_file_or_none(
    tmp_path: Path, way: str, error: int, part_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever is asked of the system, the answer may be an error."""
    monkeypatch.setattr(sink, "PART_BYTES", part_bytes)
    for at in range(400):
        folder, disk = tmp_path / str(at), Fails(once(at), error, CALLS)
        problem = attempt(folder, way, disk, monkeypatch)
        if problem.startswith("cannot create"):
            assert list(folder.iterdir()) == [], at
        else:
            assert_kept(folder, at)
            assert problem or verify(folder).pairs == len(RECORDS)
        if disk.count <= at:
            return
    pytest.fail("the last call was never reached")


@WAYS
@pytest.mark.parametrize("first", [range(3, 60, 7), heavy(range(200))])
def test_a_disk_that_stays_full_to_the_end_is_repaired_later(
    tmp_path: Path, way: str, first: range, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody else took what the reserve gave back."""
    for at in first:
        folder, disk = tmp_path / str(at), Fails(range(at, 10_000), errno.ENOSPC)
        problem = attempt(folder, way, disk, monkeypatch)
        if problem.startswith("cannot create"):
            assert list(folder.iterdir()) == [], at
        elif problem:
            recover(folder)
            assert_kept(folder, at)


def attempt(folder: Path, way: str, disk: Fails, monkeypatch: pytest.MonkeyPatch) -> str:
    """Record on a disk that fails; return the one line that was said, or nothing."""
    with monkeypatch.context() as patched:
        use_disk(patched, disk)
        try:
            write_either(folder, way)
        except RecordingError as error:
            assert "\n" not in str(error)
            return str(error)
    return ""


def assert_kept(folder: Path, at: int) -> None:
    """Check that what is in a file is what was recorded, and that no room is kept back."""
    found = verify(folder)
    assert found.sound, (at, found.false_claims)
    for each in open_recording(folder).records():
        if each.complete:
            assert_same(each, RECORDS[each.trigger])
    assert list(folder.glob("*.reserve")) == [], at


@WAYS
@pytest.mark.parametrize("most", [1, 7, 5_000])
def test_short_writes_change_nothing(
    tmp_path: Path, way: str, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = write(tmp_path / "whole", RECORDS).read_bytes()
    use_disk(monkeypatch, ShortWrites(most))
    write_either(tmp_path / "short", way)
    assert (tmp_path / "short" / "run.mcap").read_bytes() == expected


def test_a_live_recording_has_the_same_bytes_as_a_simulated_one(tmp_path: Path) -> None:
    write_live(tmp_path / "live", RECORDS)
    written = write(tmp_path / "simulated", RECORDS).read_bytes()
    assert (tmp_path / "live" / "run.mcap").read_bytes() == written


def test_a_file_system_without_direct_writes_is_written_through_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class NoDirect(RealOs):
        def open(self, path: Any, flags: int, mode: int = 0o777) -> int:
            if flags & os.O_DIRECT:
                raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
            return os.open(path, flags, mode)

    use_disk(monkeypatch, NoDirect())
    write_live(tmp_path, RECORDS)
    assert verify(tmp_path).pairs == len(RECORDS)


def test_a_file_size_limit_of_the_system_ends_the_file_in_one_line(tmp_path: Path) -> None:
    script = f"""
import resource
from pathlib import Path
from record_samples import record, write
from rig.core.errors import RecordingError
from rig.record import sink
sink.CHUNK_BYTES, sink._RESERVE_BYTES = 1, 1000
resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, {resource.RLIM_INFINITY}))
try:
    write(Path({str(tmp_path)!r}), [record(t) for t in range(20)])
except RecordingError as error:
    print(error)
"""
    said = run_python(["-c", script]).splitlines()
    assert len(said) == 1
    assert os.strerror(errno.EFBIG) in said[0]
    recover(tmp_path)  # the limit left no room for the index
    found = verify(tmp_path)
    assert found.sound
    assert 0 < found.pairs < 20


def test_a_failed_sync_is_raised_by_the_next_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class NoSync(RealOs):
        def fdatasync(self, fd: int) -> None:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(file_module, "_SYNC_EVERY_S", 0.001)
    use_disk(monkeypatch, NoSync())
    file = RecordingFile(tmp_path / "x", reserve_bytes=100, live=True)
    assert file._syncer is not None
    file._syncer._thread.join()
    with pytest.raises(OSError, match=os.strerror(errno.EIO)):
        file.write([b"more"])
    with pytest.raises(OSError, match=os.strerror(errno.EIO)):
        file.close()


class Timed(RealOs):
    """Remembers when the disk was asked to keep how many bytes."""

    def __init__(self) -> None:
        self.bytes = 0
        self.syncs: list[tuple[int, float]] = []

    def pwrite(self, fd: int, data: memoryview, start: int) -> int:
        self.bytes = max(self.bytes, start + len(data))
        return os.pwrite(fd, data, start)

    def fdatasync(self, fd: int) -> None:
        self.syncs.append((self.bytes, time.monotonic()))


def bytes_to(file: Path) -> Iterator[int]:
    """Yield for every trigger where the chunk with it ends."""
    with Container(file) as source:
        summary = source.summary()
        for chunk in summary.chunks([topics.PAIR]):
            for _ in source.message_offsets(chunk, topics.PAIR):
                yield chunk.start + chunk.size


@pytest.mark.heavy
@pytest.mark.parametrize("rate_hz", [4, 50])
def test_the_disk_keeps_every_trigger_within_a_second(
    tmp_path: Path, rate_hz: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Small pictures would wait long for others to fill a chunk with."""
    monkeypatch.undo()
    disk, written_s = Timed(), []
    use_disk(monkeypatch, disk)
    with RecordWriter(tmp_path, HEADER, real_time=True) as writer:
        for trigger in range(3 * rate_hz):
            writer.write(record(trigger))
            written_s.append(time.monotonic())
            time.sleep(1 / rate_hz)
        time.sleep(1.0)
    kept_s = [
        next(at_s for size, at_s in disk.syncs if size >= end)
        for end in bytes_to(tmp_path / "run.mcap")
    ]
    assert len(kept_s) == len(written_s)
    assert max(kept - written for kept, written in zip(kept_s, written_s, strict=True)) < 1.0


def test_a_trigger_does_not_wait_for_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A live chunk is closed when it is old, also when no trigger comes any more."""
    monkeypatch.setattr(sink, "CHUNK_BYTES", 1 << 20)
    monkeypatch.setattr(sink, "CHUNK_S", 0.01)
    with RecordWriter(tmp_path, HEADER, real_time=True) as writer:
        begun = writer.path.stat().st_size
        writer.write(RECORDS[0])
        deadline_s = time.monotonic() + 10.0
        while writer.path.stat().st_size == begun:
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
    assert verify(tmp_path).pairs == 1


def journaled(folder: Path, live: bool, monkeypatch: pytest.MonkeyPatch) -> tuple[Journal, Any]:
    """Write 24 triggers; return what the disk was given, and how many events each trigger took."""
    journal, ends = Journal(), []
    use_disk(monkeypatch, journal)
    folder.mkdir()
    whole = Sink(folder / "run.mcap", HEADER, live=live)
    ends.append(len(journal.events))
    for trigger in range(24):
        whole.take(record(trigger))
        ends.append(len(journal.events))
        if trigger % 5 == 4:
            journal.fdatasync(whole._part._file._backing.fd)
    whole.finish()
    whole.close_file()
    monkeypatch.undo()
    return journal, ends


@pytest.mark.parametrize("part_bytes", [1 << 30, 30_000], ids=["one file", "parts"])
@pytest.mark.parametrize("live", [True, False], ids=["live", "simulated"])
@pytest.mark.parametrize("seeds", fast_and_heavy(40, 1_000))
def test_lost_power_costs_only_what_was_not_synced(
    tmp_path: Path, seeds: range, live: bool, part_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever became of the writes after the last sync, those before it are there."""
    monkeypatch.setattr(sink, "PART_BYTES", part_bytes)
    monkeypatch.setattr(sink, "CHUNK_BYTES", 1)
    journal, ends = journaled(tmp_path / "whole", live, monkeypatch)
    for seed in seeds:
        draw = random.Random(seed)
        events = draw.randint(1, len(journal.events))
        lost = min(journal.unsure(events), default=events)
        safe = sum(end <= lost for end in ends)
        folder = tmp_path / str(seed)
        folder.mkdir()
        for name, data in journal.state(events, draw).items():
            (folder / name).write_bytes(data)
        try:
            recover(folder)
        except RecordingError as error:
            assert safe == 0, (seed, error)
            continue
        found = verify(folder)
        assert found.sound, (seed, found.false_claims)
        assert found.pairs >= safe - 1, seed
        for each in open_recording(folder).records():
            assert_same(each, record(each.trigger))


@pytest.mark.parametrize("step", [101, heavy(1)])
def test_a_cut_at_any_byte_is_repaired_or_refused(
    tmp_path: Path, step: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Most cuts leave the same file behind, which is verified once."""
    whole = write(tmp_path / "whole", [record(0), half(1), record(2)]).read_bytes()
    monkeypatch.setattr(os, "fsync", lambda _: None)
    file = tmp_path / "run.mcap"
    kept, verified = 0, b""
    for size in range(0, len(whole), step):
        file.write_bytes(whole[:size])
        try:
            found = recover(file)
        except RecordingError as error:
            assert "\n" not in str(error)
            assert file.read_bytes() == whole[:size]
            assert kept == 0
            continue
        assert found.triggers >= kept
        kept = found.triggers
        if file.read_bytes() != verified:
            verified = file.read_bytes()
            proof = verify(file)
            assert proof.sound
            assert proof.pairs + sum(proof.lost.values()) == kept
    assert kept == 3


def large(trigger: int) -> PairRecord:
    """Return a trigger with pictures of full size."""
    pixels = np.full((1536, 2048), trigger, np.uint8)
    shot = record(trigger).shot
    return replace(record(trigger), shot=Pair(*(replace(f, image=pixels) for f in shot)))  # type: ignore[type-var]


@pytest.mark.parametrize(
    ("triggers", "cuts"), [(4, 6), pytest.param(40, 40, marks=pytest.mark.heavy)]
)
def test_a_large_file_cut_anywhere_loses_one_chunk_at_most(
    tmp_path: Path, triggers: int, cuts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With full-size pictures each trigger is a chunk of 6.3 MB; the cuts go from the end on."""
    monkeypatch.undo()
    large_lens = replace(INTRINSICS, width_px=2048, height_px=1536)
    header = replace(HEADER, intrinsics=Pair(large_lens, large_lens))
    path = write(tmp_path, [large(t) for t in range(triggers)], header)
    ends = list(bytes_to(path))
    draw = random.Random(0)
    sizes = [draw.randrange(ends[0], path.stat().st_size) for _ in range(cuts)]
    for size in sorted(sizes, reverse=True):
        os.truncate(path, size)
        found = recover(path)
        assert found.repaired
        assert found.triggers == verify(path).pairs == sum(end <= size for end in ends)


@pytest.mark.parametrize("seeds", fast_and_heavy(60, 2_000))
def test_a_damaged_stretch_in_the_middle_is_stepped_over(tmp_path: Path, seeds: range) -> None:
    """Sizes, opcodes and pixels that were overwritten cost their own chunks, never the rest."""
    whole = write(tmp_path / "whole", [record(t) for t in range(40)]).read_bytes()
    file = tmp_path / "run.mcap"
    for seed in seeds:
        draw = random.Random(seed)
        data = bytearray(whole)
        start, size = draw.randrange(16_000, 40_000), draw.choice([1, 9, 200, 6_000])
        data[start : start + size] = draw.randbytes(size)
        file.write_bytes(data)
        recover(file)
        found = {each.trigger for each in open_recording(file).records()}
        assert len(found) >= 40 - 2 - size // 1_500, seed
        assert verify(file).sound == (found == set(range(40)))
        assert not recover(file).repaired


@pytest.mark.usefixtures("small_parts")
@WAYS
def test_a_long_run_is_split_without_a_gap(tmp_path: Path, way: str) -> None:
    records = [record(0), half(1), *(record(t) for t in range(2, 90))]
    (write_live if way == "live" else write)(tmp_path, records)
    files = parts(tmp_path / "run.mcap")
    assert [file.name for file in files] == [
        "run.mcap",
        *(f"run_{n}.mcap" for n in range(1, len(files))),
    ]
    assert len(files) > 3
    assert all(file.stat().st_size < PART_BYTES + 30_000 for file in files)
    found = verify(tmp_path)
    assert (found.sound, found.pairs) == (True, 89), found.false_claims
    recording = open_recording(tmp_path)
    assert len(recording) == 90
    for each, expected in zip(recording.records(), records, strict=True):
        assert_same(each, expected)
    assert not recover(tmp_path).repaired


@pytest.mark.usefixtures("small_parts")
def test_parts_that_do_not_belong_together_are_found(tmp_path: Path) -> None:
    write(tmp_path / "a", [record(t) for t in range(60)])
    files = parts(tmp_path / "a" / "run.mcap")
    with pytest.raises(RecordingError, match=r"run_1\.mcap is a later part of .*run\.mcap"):
        open_recording(files[1])
    last = files[-1].read_bytes()
    files[-1].unlink()
    with pytest.raises(RecordingError, match=f"{files[-1].name} is missing"):
        open_recording(tmp_path / "a")
    files[-1].write_bytes(last)
    files[1].unlink()
    with pytest.raises(RecordingError, match=r"run_1\.mcap is missing"):
        open_recording(tmp_path / "a")
    files[1].write_bytes(files[2].read_bytes())
    assert not verify(tmp_path / "a").sound


@pytest.mark.usefixtures("small_parts")
def test_a_part_that_was_only_begun_is_taken_away(tmp_path: Path) -> None:
    write(tmp_path, [record(t) for t in range(60)])
    files = parts(tmp_path / "run.mcap")
    files[-1].write_bytes(files[-1].read_bytes()[:300])
    found = recover(tmp_path)
    assert found.repaired
    assert parts(tmp_path / "run.mcap") == files[:-1]
    assert verify(tmp_path).sound
    assert not recover(tmp_path).repaired


def run_python(arguments: list[str]) -> str:
    paths = map(str, (Path(__file__).parents[2], Path(__file__).parents[1]))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    return subprocess.run(
        [sys.executable, *arguments], env=environment, check=True, capture_output=True, text=True
    ).stdout


def signalled(
    folder: Path, seeds: range, signals: list[int], part_bytes: int = 1 << 30
) -> Iterator[dict[str, Any]]:
    asked = {"folder": str(folder), "seeds": list(seeds), "signals": signals}
    asked |= {"part_bytes": part_bytes}
    child = str(Path(__file__).parents[1] / "record_child.py")
    for line in run_python([child, json.dumps(asked)]).splitlines():
        yield json.loads(line)


@pytest.mark.parametrize("part_bytes", [1 << 30, PART_BYTES])
@pytest.mark.parametrize("seeds", fast_and_heavy(4, 60))
def test_a_kill_at_any_moment_costs_a_chunk_at_most(
    tmp_path: Path, seeds: range, part_bytes: int
) -> None:
    for told in signalled(tmp_path, seeds, [9], part_bytes):
        assert told["code"] == -9
        folder = Path(told["folder"])
        with pytest.raises(RecordingDamaged):
            open_recording(folder)
        assert recover(folder).repaired, told
        found = verify(folder)
        assert found.sound, (told, found.false_claims)
        assert found.pairs + sum(found.lost.values()) >= told["kept"], told
        assert list(folder.glob("*.reserve")) == []


SIGNALS = {"interrupt": [2], "two interrupts": [2, 2], "terminate": [15]}


@pytest.mark.parametrize("signals", SIGNALS.values(), ids=SIGNALS)
@pytest.mark.parametrize("seeds", fast_and_heavy(4, 71))
def test_a_signal_at_any_moment_leaves_a_whole_file(
    tmp_path: Path, seeds: range, signals: list[int]
) -> None:
    """With the heavy seeds 213 moments; each file is whole within two seconds."""
    for told in signalled(tmp_path, seeds, signals):
        assert told["code"] in (130, -2), told
        assert told["seconds"] < 2.0, told
        found = verify(Path(told["folder"]))
        assert found.sound, (told, found.false_claims)
        assert found.pairs + sum(found.lost.values()) >= told["kept"], told


def test_the_next_start_repairs_what_a_killed_run_left(tmp_path: Path) -> None:
    list(signalled(tmp_path, range(2), [9]))
    write(tmp_path / "whole", RECORDS)
    repaired = dict(repair_left_behind(tmp_path))
    assert set(repaired) == {tmp_path / name / "run.mcap" for name in ("0", "1")}
    assert all(verify(path).sound for path in repaired)
    assert list(repair_left_behind(tmp_path)) == []


def test_what_cannot_be_repaired_is_said(tmp_path: Path) -> None:
    (tmp_path / "0").mkdir()
    (tmp_path / "0" / "run.mcap").write_bytes(b"")
    (tmp_path / "0" / "run.mcap.reserve").write_bytes(b"")
    ((path, problem),) = repair_left_behind(tmp_path)
    assert path == tmp_path / "0" / "run.mcap"
    assert isinstance(problem, RecordingError)


def test_a_recording_that_is_being_written_is_left_alone(tmp_path: Path) -> None:
    with RecordWriter(tmp_path / "0", HEADER, real_time=True) as writer:
        writer.write(RECORDS[0])
        with pytest.raises(RecordingError, match="is being recorded"):
            recover(tmp_path / "0")
        assert list(repair_left_behind(tmp_path)) == []
    assert verify(tmp_path / "0").pairs == 1


@pytest.mark.parametrize(
    ("expected", "words"),
    [
        (Expected(1_000, 10.0), r"room for 36 s of pictures \(2 MB, 361 triggers of 1000\)"),
        (Expected(None, 55.0), r"room for 7 s of pictures \(2 MB, 361 triggers of 550\)"),
    ],
)
def test_a_disk_too_small_for_the_run_is_refused_with_seconds(
    tmp_path: Path, expected: Expected, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_module, "free_bytes", lambda _: 2_000_000)
    with (
        pytest.raises(RecordingError, match=words),
        RecordWriter(tmp_path / "run", HEADER, real_time=True, expected=expected),
    ):
        pass
    assert not (tmp_path / "run").exists()
    with RecordWriter(tmp_path / "run", HEADER, real_time=True, expected=Expected(300, 10.0)):
        pass


def test_free_room_is_that_of_the_disk(tmp_path: Path) -> None:
    room = os.statvfs(tmp_path)
    found = file_module.free_bytes(tmp_path / "not" / "there")
    assert found == pytest.approx(room.f_bavail * room.f_frsize, rel=0.1)
