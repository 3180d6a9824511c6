"""triggers = complete pairs + recorded causes, whatever happens in whatever order."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import ClassVar
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test
from record_disk import RealOs
from record_samples import HEADER, assert_same, half, mispaired, neither, record

from rig.core.errors import RecordingError
from rig.core.types import Lost, PairRecord
from rig.record import backing, sink, writer
from rig.record import file as file_module
from rig.record.container import parts
from rig.record.reader import open_recording
from rig.record.recover import recover
from rig.record.verify import verify
from rig.record.writer import DISK_FULL, QUEUE_FULL, RecordWriter, without_pictures

KINDS = [record, half, neither, mispaired]
PLACES = 4


class FaultyDisk(RealOs):
    """A disk that can stall, fill up once, and break; nothing is written while `still` is held."""

    def __init__(self) -> None:
        self.running = threading.Event()
        self.running.set()
        self.still = threading.Lock()
        self.error: int | None = None

    def pwrite(self, fd: int, data: memoryview, start: int) -> int:
        with self._turn():
            return os.pwrite(fd, data, start)

    def writev(self, fd: int, views: Sequence[memoryview]) -> int:
        with self._turn():
            return os.writev(fd, views)

    @contextmanager
    def _turn(self) -> Iterator[None]:
        self.running.wait()
        if self.error is not None:
            error, self.error = self.error, None
            raise OSError(error, os.strerror(error))
        with self.still:
            yield


def copy_unless_given_back(source: str, target: str) -> None:
    """Copy a file; a reserve may go while nothing is written, and then was not there any more."""
    gone = (FileNotFoundError,) if source.endswith(".reserve") else ()
    with suppress(*gone):
        shutil.copy2(source, target)


class Recorder(RuleBasedStateMachine):
    """Writes, stalls, fills, breaks, kills and cuts live recordings, and recounts them."""

    steps: ClassVar[int] = 0

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="rig-accounting-"))
        self.disk = FaultyDisk()
        self.patches = [
            patch.object(sink, "CHUNK_BYTES", 1),
            patch.object(sink, "PART_BYTES", 60_000),
            patch.object(sink, "_RESERVE_BYTES", 50_000),
            patch.object(writer, "_WAITING_REAL_TIME", PLACES),
            *(patch.object(module, "os", self.disk) for module in (backing, file_module)),
        ]
        for each in self.patches:
            each.start()
        self.runs = 0
        self.ended = True
        self.given: list[PairRecord] = []
        self.begin()

    @property
    def run(self) -> Path:
        return self.folder / str(self.runs)

    @precondition(lambda self: self.ended)
    @rule()
    def begin(self) -> None:
        self._count_step()
        self.runs += 1
        self.given = []
        self.broken = self.ended = False
        self.disk.error = None
        self.disk.running.set()
        self.recorder = RecordWriter(self.run, HEADER, real_time=True).__enter__()

    @precondition(lambda self: not self.ended)
    @rule(kind=st.sampled_from(KINDS), count=st.integers(1, 4))
    def write(self, kind: Callable[[int], PairRecord], count: int) -> None:
        self._count_step()
        for _ in range(count):
            given = kind(len(self.given))
            try:
                self.recorder.write(given)
            except RecordingError:
                assert self.broken
                continue
            self.given.append(given)

    @precondition(lambda self: not self.ended)
    @rule()
    def stall(self) -> None:
        self._count_step()
        self.disk.running.clear()

    @precondition(lambda self: not self.ended)
    @rule()
    def go_on(self) -> None:
        self._count_step()
        self.disk.running.set()

    @precondition(lambda self: not self.broken and not self.ended)
    @rule(error=st.sampled_from([errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG]))
    def break_disk(self, error: int) -> None:
        self._count_step()
        self.disk.error = error
        self.broken = True

    @precondition(lambda self: not self.broken and not self.ended)
    @rule(part=st.floats(0.0, 1.0))
    def kill(self, part: float) -> None:
        """Look at what SIGKILL would leave now, whole and with its last file cut."""
        self._count_step()
        killed = self.folder / "killed"
        with self.disk.still:
            kept = self.recorder._sink.triggers
            shutil.copytree(self.run, killed, copy_function=copy_unless_given_back)
        recover(killed)
        assert self.recount(killed) >= kept
        last = parts(killed / writer.FILE_NAME)[-1]
        os.truncate(last, round(part * last.stat().st_size))
        with suppress(RecordingError):
            recover(killed)
            assert self.recount(killed) <= len(self.given)
        shutil.rmtree(killed)

    @precondition(lambda self: not self.ended)
    @rule()
    def end(self) -> None:
        self._count_step()
        self.ended = True
        self.disk.running.set()
        try:
            self.recorder.__exit__(None, None, None)
        except RecordingError:
            assert self.broken
        assert not recover(self.run).repaired
        count = self.recount(self.run)
        assert self.broken or count == len(self.given)
        shutil.rmtree(self.run)

    def recount(self, path: Path) -> int:
        """Check that a file holds what was given, or why not; return its number of triggers."""
        found = verify(path)
        assert found.sound, found.false_claims
        kept = list(open_recording(path).records())
        assert len(kept) == found.pairs + sum(found.lost.values())
        causes: Counter[str] = Counter()
        for each, given in zip(kept, self.given, strict=False):
            causes[each.cause] += 1
            new = each.cause if each.cause != given.cause else ""
            assert new in ("", QUEUE_FULL, DISK_FULL)
            lost = {shot.cause for shot in each.shot if isinstance(shot, Lost)}
            by_recorder = max(lost & {QUEUE_FULL, DISK_FULL}, default="")
            assert_same(each, without_pictures(given, by_recorder) if by_recorder else given)
        assert causes.pop("", 0) == found.pairs
        assert causes == Counter(found.lost)
        return len(kept)

    def teardown(self) -> None:
        if not self.ended:
            self.end()
        for each in self.patches:
            each.stop()
        shutil.rmtree(self.folder)

    def _count_step(self) -> None:
        Recorder.steps += 1


def account(examples: int, steps: int) -> int:
    """Let the machine run; return how many steps it took."""
    before = Recorder.steps
    run_state_machine_as_test(
        Recorder,
        settings=settings(
            max_examples=examples,
            stateful_step_count=steps,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        ),
    )
    return Recorder.steps - before


def test_the_accounting_holds() -> None:
    assert account(examples=20, steps=20) > 100


@pytest.mark.heavy
def test_the_accounting_holds_over_ten_thousand_steps() -> None:
    steps = 0
    while steps < 10_000:
        steps += account(examples=100, steps=60)
