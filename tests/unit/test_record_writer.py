"""The writer under a slow disk, a full disk, a broken disk, and Ctrl-C."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from record_disk import SmallDisk
from record_samples import HEADER, assert_same, frame, half, record, write

from rig.core.errors import RecordingError
from rig.core.types import Pair, PairRecord
from rig.record import backing, sink, writer
from rig.record import file as file_module
from rig.record.info import info
from rig.record.reader import open_recording
from rig.record.recover import recover
from rig.record.verify import verify
from rig.record.writer import DISK_FULL, QUEUE_FULL, RecordWriter


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Let nothing reach the file until the event is set."""
    opened = threading.Event()
    take = sink.Sink.take

    def wait_and_take(self: sink.Sink, record: PairRecord) -> None:
        opened.wait()
        take(self, record)

    monkeypatch.setattr(sink.Sink, "take", wait_and_take)
    return opened


def test_a_slow_disk_in_real_time_costs_counted_pictures(
    tmp_path: Path, gate: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "_WAITING_REAL_TIME", 3)
    with RecordWriter(tmp_path, HEADER, real_time=True) as recorder:
        for trigger in range(3):
            recorder.write(record(trigger))
        recorder.write(record(3))
        recorder.write(half(4))
        gate.set()
        while recorder._places.empty():
            time.sleep(0.001)
        recorder.write(record(5))
    assert recorder.pairs_dropped == 1  # trigger 4 was half lost before it came here
    found = verify(tmp_path)
    assert found.sound
    assert found.pairs == 4
    assert found.lost == {QUEUE_FULL: 1, "secondary: no frame in 0.5 s": 1}
    records = list(open_recording(tmp_path).records())
    assert [shot.sequence for shot in records[3].shot] == [3, 3]
    assert records[3].decisions == record(3).decisions
    assert records[4].shot.secondary == half(4).shot.secondary


def at_55_hz(trigger: int) -> PairRecord:
    time_ns = trigger * 1_000_000_000 // 55
    shot = Pair(*(replace(frame(trigger), device_time_ns=time_ns) for _ in range(2)))
    return replace(record(trigger), shot=shot, offset_ns=0)


def test_a_stall_of_five_seconds_costs_what_did_not_fit_and_is_told(
    tmp_path: Path, gate: threading.Event
) -> None:
    """The gate opens only when all were given: a `write` that waited would wait for ever."""
    with RecordWriter(tmp_path, HEADER, real_time=True) as recorder:
        for trigger in range(275):
            recorder.write(at_55_hz(trigger))
        gate.set()
        while recorder._places.qsize() < 110:
            time.sleep(0.001)
        for trigger in range(275, 300):
            recorder.write(at_55_hz(trigger))
    found = verify(tmp_path)
    assert (found.sound, found.pairs, found.lost) == (True, 135, {QUEUE_FULL: 165})
    (loss,) = info(tmp_path).losses
    assert loss.cause == QUEUE_FULL
    assert (loss.first_trigger, loss.last_trigger) == (110, 274)
    assert (loss.start_s, loss.end_s) == pytest.approx((109 / 55, 275 / 55), abs=1e-6)


def test_a_slow_disk_in_virtual_time_is_waited_for(tmp_path: Path, gate: threading.Event) -> None:
    threading.Timer(0.05, gate.set).start()
    file = write(tmp_path, [record(t) for t in range(30)])
    assert verify(file).pairs == 30


def test_a_disk_that_takes_nothing_for_ever_is_an_error(
    tmp_path: Path, gate: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "_STALLED_TRIGGERS", 200)

    def overrun() -> None:
        with RecordWriter(tmp_path, HEADER, real_time=True) as recorder:
            try:
                for trigger in range(400):
                    recorder.write(record(trigger))
            finally:
                gate.set()

    with pytest.raises(RecordingError, match="took nothing during 200 triggers"):
        overrun()
    assert verify(tmp_path).sound


def use_disk(monkeypatch: pytest.MonkeyPatch, disk: object) -> None:
    for module in (backing, file_module):
        monkeypatch.setattr(module, "os", disk)


RECORDS = [record(t) for t in range(6)]
MARGIN = 100_000


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sink, "CHUNK_BYTES", 1)
    monkeypatch.setattr(sink, "_RESERVE_BYTES", MARGIN)


@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize("room", range(0, 32_000, 2_000))
def test_a_full_disk_ends_the_file_and_is_said_once(
    tmp_path: Path, room: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_disk(monkeypatch, SmallDisk(2 * MARGIN + room))
    with pytest.raises(RecordingError, match="disk is full at trigger") as caught:
        write(tmp_path, RECORDS)
    assert "\n" not in str(caught.value)
    found = verify(tmp_path)
    assert found.sound, found.false_claims
    assert found.pairs >= 1
    assert set(found.lost) <= {DISK_FULL}
    records = list(open_recording(tmp_path).records())
    for each in records[: found.pairs]:
        assert_same(each, RECORDS[each.trigger])
    assert not (tmp_path / "run.mcap.reserve").exists()


@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize("room", range(32_500, 40_000, 1_500))
def test_a_disk_that_fills_up_with_the_index_costs_nothing(
    tmp_path: Path, room: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_disk(monkeypatch, SmallDisk(2 * MARGIN + room))
    found = verify(write(tmp_path, RECORDS))
    assert (found.sound, found.pairs, found.lost) == (True, len(RECORDS), {})


def test_a_disk_without_room_is_refused_at_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_disk(monkeypatch, SmallDisk(1_000_000))
    with pytest.raises(RecordingError, match=r"cannot create .*run.mcap: No space left on device"):
        write(tmp_path, RECORDS)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize("error", [errno.EIO, errno.EFBIG])
@pytest.mark.parametrize("room", range(12_000, 36_000, 3_000))
def test_a_broken_disk_keeps_what_was_written(
    tmp_path: Path, room: int, error: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_disk(monkeypatch, SmallDisk(room, error))
    with pytest.raises(RecordingError, match=os.strerror(error)):
        write(tmp_path, RECORDS)
    found = verify(tmp_path)
    assert found.sound, found.false_claims
    for each in open_recording(tmp_path).records():
        assert_same(each, RECORDS[each.trigger])
    assert info(tmp_path).recovered or found.pairs == len(RECORDS)


def test_of_two_runs_into_one_folder_at_once_one_is_refused(tmp_path: Path) -> None:
    for number in range(20):
        folder, together, refused = tmp_path / str(number), threading.Barrier(2), []

        def run(trigger: int, folder: Path, together: threading.Barrier, said: list[str]) -> None:
            together.wait()
            try:
                with RecordWriter(folder, HEADER, real_time=True) as recorder:
                    recorder.write(record(trigger))
                    together.wait()
            except RecordingError as error:
                said.append(str(error))
                together.wait()

        arguments = (folder, together, refused)
        runs = [threading.Thread(target=run, args=(trigger, *arguments)) for trigger in (0, 7)]
        for each in runs:
            each.start()
        for each in runs:
            each.join()
        assert len(refused) == 1
        assert "exists already and is kept" in refused[0]
        (kept,) = open_recording(folder).records()
        assert_same(kept, record(kept.trigger))


def test_a_time_before_the_clock_began_does_not_spoil_the_file(tmp_path: Path) -> None:
    early = replace(frame(1), device_time_ns=-1)
    with pytest.raises(RecordingError, match=r"trigger 1 .* before the run's clock began"):
        write(tmp_path, [record(0), replace(record(1), shot=Pair(early, early))])
    assert verify(tmp_path).sound
    assert len(open_recording(tmp_path)) == 1


def test_an_error_of_the_thread_is_raised_by_the_next_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = replace(record(1), shot=Pair(replace(frame(1), image=np.zeros((24, 32))), frame(1, 40)))
    raised = []
    with RecordWriter(tmp_path, HEADER, real_time=False) as recorder:
        recorder.write(record(0))
        recorder.write(bad)
        try:
            for trigger in range(2, 1_000):
                recorder.write(record(trigger))
                time.sleep(0.001)
        except RecordingError as error:
            raised.append(str(error))
    assert "cannot record trigger 1" in raised[0]
    assert "not a uint8 picture" in raised[0]
    assert [r.trigger for r in open_recording(tmp_path).records()] == [0]
    assert verify(tmp_path).sound


def test_ctrl_c_finalises(tmp_path: Path) -> None:
    def interrupted() -> None:
        with RecordWriter(tmp_path, HEADER, real_time=True) as recorder:
            for trigger in range(5):
                recorder.write(record(trigger))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert verify(tmp_path).pairs == 5


def test_writing_outside_of_a_with_block_is_refused(tmp_path: Path) -> None:
    recorder = RecordWriter(tmp_path, HEADER, real_time=False)
    with pytest.raises(RecordingError, match="not open"):
        recorder.write(record(0))
    with recorder:
        pass
    with pytest.raises(RecordingError, match="not open"):
        recorder.write(record(0))


ENDLESS = """
import itertools, signal, sys
from pathlib import Path
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell ignores it
from record_disk import SmallDisk
from record_samples import HEADER, record
from rig.record.writer import RecordWriter
with RecordWriter(Path(sys.argv[1]), HEADER, real_time=False) as recorder:
    for trigger in itertools.count():
        recorder.write(record(trigger))
        if trigger == 2000:
            print("running", flush=True)
"""


def run_until_signalled(folder: Path, *signals: int) -> int:
    """Record for ever in a process of its own, then send it the signals."""
    paths = map(str, (Path(__file__).parents[2], Path(__file__).parents[1]))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, "-c", ENDLESS, str(folder)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        for each in signals:
            process.send_signal(each)
            time.sleep(0.01)
        try:
            process.communicate(timeout=30)
        finally:
            process.kill()
    return process.returncode


def test_two_interrupts_leave_a_whole_file(tmp_path: Path) -> None:
    assert run_until_signalled(tmp_path, signal.SIGINT, signal.SIGINT) != 0
    found = verify(tmp_path)
    assert found.sound
    assert found.pairs > 2000


def test_a_killed_run_is_recovered(tmp_path: Path) -> None:
    assert run_until_signalled(tmp_path, signal.SIGKILL) == -signal.SIGKILL
    with pytest.raises(RecordingError, match="rig recover"):
        open_recording(tmp_path)
    assert recover(tmp_path).repaired
    found = verify(tmp_path)
    assert found.sound
    assert found.pairs > 0
