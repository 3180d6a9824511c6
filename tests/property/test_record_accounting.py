"""triggers = complete pairs + recorded causes, whatever happens in whatever order."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import threading
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test
from record_disk import RealOs
from record_samples import HEADER, assert_same, half, mispaired, neither, record

from rig.core.errors import RecordingError
from rig.core.types import PairRecord
from rig.record import backing, sink, writer
from rig.record import file as file_module
from rig.record.reader import open_recording
from rig.record.recover import recover
from rig.record.verify import verify
from rig.record.writer import DISK_FULL, QUEUE_FULL, RecordWriter, without_pictures

KINDS = [record, half, neither, mispaired]
PLACES = 4


class FaultyDisk(RealOs):
    """A disk that can stall, fill up once, and break."""

    def __init__(self) -> None:
        self.running = threading.Event()
        self.running.set()
        self.error: int | None = None

    def pwrite(self, fd: int, data: memoryview, start: int) -> int:
        self._wait()
        return os.pwrite(fd, data, start)

    def writev(self, fd: int, views: Sequence[memoryview]) -> int:
        self._wait()
        return os.writev(fd, views)

    def _wait(self) -> None:
        self.running.wait()
        if self.error is not None:
            error, self.error = self.error, None
            raise OSError(error, os.strerror(error))


class Recorder(RuleBasedStateMachine):
    """Writes, stalls, fills and breaks a live recording, and recounts it from the file."""

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
        self.recorder = RecordWriter(self.folder / "run", HEADER, real_time=True).__enter__()
        self.given: list[PairRecord] = []
        self.broken = False
        self.ended = False

    @precondition(lambda self: not self.ended)
    @rule(kind=st.sampled_from(KINDS), count=st.integers(1, 4))
    def write(self, kind: object, count: int) -> None:
        for _ in range(count):
            assert callable(kind)
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
        self.disk.running.clear()

    @rule()
    def go_on(self) -> None:
        self.disk.running.set()

    @precondition(lambda self: not self.broken and not self.ended)
    @rule(error=st.sampled_from([errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG]))
    def break_disk(self, error: int) -> None:
        self.disk.error = error
        self.broken = True

    @precondition(lambda self: not self.ended)
    @rule()
    def end(self) -> None:
        self.ended = True
        self.disk.running.set()
        try:
            self.recorder.__exit__(None, None, None)
        except RecordingError:
            assert self.broken
        self.count()

    def count(self) -> None:
        path = self.folder / "run"
        assert not recover(path).repaired
        found = verify(path)
        assert found.sound, found.false_claims
        kept = list(open_recording(path).records())
        assert len(kept) == found.pairs + sum(found.lost.values())
        assert self.broken or len(kept) == len(self.given)
        causes: Counter[str] = Counter()
        for each, given in zip(kept, self.given, strict=False):
            causes[each.cause] += 1
            new = each.cause if each.cause != given.cause else ""
            assert new in ("", QUEUE_FULL, DISK_FULL)
            lost = {shot.cause for shot in each.shot if hasattr(shot, "cause")}
            by_recorder = (lost & {QUEUE_FULL, DISK_FULL}) or {""}
            assert_same(
                each, without_pictures(given, max(by_recorder)) if max(by_recorder) else given
            )
        assert causes.pop("", 0) == found.pairs
        assert causes == Counter(found.lost)

    def teardown(self) -> None:
        if not self.ended:
            self.end()
        for each in self.patches:
            each.stop()
        shutil.rmtree(self.folder)


def account(examples: int, steps: int) -> None:
    run_state_machine_as_test(
        Recorder,
        settings=settings(
            max_examples=examples,
            stateful_step_count=steps,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        ),
    )


def test_the_accounting_holds() -> None:
    account(examples=25, steps=20)


@pytest.mark.heavy
def test_the_accounting_holds_over_ten_thousand_steps() -> None:
    account(examples=250, steps=50)
