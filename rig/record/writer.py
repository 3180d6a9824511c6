"""Writes a run to `run.mcap` from a thread of its own."""

from __future__ import annotations

import dataclasses
import math
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from rig.core.errors import DiskFull, RecordingError
from rig.core.types import Frame, Lost, Pair, PairRecord
from rig.record import bag, file
from rig.record.header import RunHeader
from rig.record.recover import recover
from rig.record.sink import Sink

FILE_NAME = "run.mcap"
QUEUE_FULL, DISK_FULL = "recorder queue full", "disk full"

_WAITING_REAL_TIME = 110
_WAITING_VIRTUAL_TIME = 8
_STALLED_TRIGGERS = 10_000
_LOOK_UP_S = 0.1
_SMALL_BYTES = 2_000
_SHORTEST_S = 10.0
_FASTEST_HZ = 55.0


@dataclass(frozen=True, slots=True)
class Expected:
    """How long a run will be: None is without end, or as fast as the exposures allow."""

    triggers: int | None = None
    rate_hz: float | None = None


UNKNOWN = Expected()


class RecordWriter:
    """A `Recorder` that writes `folder/run.mcap` for ROS 2 tools.

    At most 110 pairs (two seconds at 55 Hz) wait for the disk in real time, then a trigger loses
    its pictures, never its record: both frames become `Lost` with cause "recorder queue full".
    In virtual time `write` waits instead. Frames are not copied, so they must not change after
    `write`. A failure to write is raised as RecordingError by the next `write`, or at the end of
    the `with` block, after which the file is finalised with all that was written.
    """

    def __init__(
        self, folder: Path, header: RunHeader, *, real_time: bool, expected: Expected = UNKNOWN
    ) -> None:
        self.path = folder / FILE_NAME
        self._header = header
        self._expected = expected
        self._real_time = real_time
        self._queue: queue.SimpleQueue[tuple[PairRecord, bool] | None] = queue.SimpleQueue()
        self._places: queue.SimpleQueue[None] = queue.SimpleQueue()
        for _ in range(_WAITING_REAL_TIME if real_time else _WAITING_VIRTUAL_TIME):
            self._places.put(None)
        self._pairs_dropped = 0
        self._failure: RecordingError | None = None
        self._reported = False
        self._stopped = False
        self._torn = False
        self._open = False
        self._done = threading.Event()

    def __enter__(self) -> Self:
        """Create the file; raises RecordingError when it exists or there is no room for it."""
        try:
            self._refuse_low_disk()
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._sink = Sink(self.path, self._header, live=self._real_time)
        except FileExistsError:
            raise RecordingError(
                f"{self.path} exists already and is kept; name another folder with --out"
            ) from None
        except OSError as error:
            raise RecordingError(
                f"cannot create {self.path}: {error.strerror}; name another folder with --out"
            ) from error
        if self._real_time:
            file.keep_picture_buffers()
        self._owner = threading.current_thread()
        threading.Thread(target=self._work, name="rig-recorder").start()
        self._open = True
        return self

    @property
    def pairs_dropped(self) -> int:
        """Return how many whole pairs were lost here, because the disk was too slow."""
        return self._pairs_dropped

    def write(self, record: PairRecord) -> None:
        """Queue one record; raises RecordingError when an earlier one could not be written."""
        if not self._open:
            raise RecordingError(f"{self.path} is not open for writing; use a with block")
        self._report()
        if self._take_place():
            self._queue.put((record, True))
            return
        self._pairs_dropped += record.cause == ""
        self._queue.put((without_pictures(record, QUEUE_FULL), False))
        if self._queue.qsize() > _STALLED_TRIGGERS:
            raise RecordingError(
                f"{self.path}: the disk took nothing during {_STALLED_TRIGGERS} triggers; "
                "name a folder on another disk with --out"
            )

    def __exit__(self, *exc: object) -> None:
        """Write what is queued and end the file, also after Ctrl-C, once or twice."""
        interrupted = False
        while self._open or not self._done.is_set():
            try:
                self._open = False
                self._queue.put(None)
                self._done.wait()  # an interrupted Thread.join takes the thread for ended
            except KeyboardInterrupt:
                interrupted = True
        self._report()
        if interrupted:
            raise KeyboardInterrupt

    def _refuse_low_disk(self) -> None:
        """Raise RecordingError when the run, or ten seconds of an endless one, will not fit."""
        room = file.free_bytes(self.path.parent)
        lenses = self._header.intrinsics
        fits = room // sum(lens.width_px * lens.height_px + _SMALL_BYTES for lens in lenses)
        rate_hz = self._expected.rate_hz or _FASTEST_HZ
        wanted = self._expected.triggers or math.ceil(_SHORTEST_S * rate_hz)
        if fits < wanted:
            raise RecordingError(
                f"{self.path.parent}: the disk has room for {fits / rate_hz:.0f} s of pictures "
                f"({room / 1e6:.0f} MB, {fits} triggers of {wanted}); free space, take fewer "
                "--frames, or name a folder on another disk with --out"
            )

    def _take_place(self) -> bool:
        try:
            self._places.get(block=not self._real_time)
        except queue.Empty:
            return False
        return True

    def _report(self) -> None:
        if self._failure is not None and not self._reported:
            self._reported = True
            raise self._failure

    def _work(self) -> None:
        """Run the thread: every place taken is given back, whatever happens."""
        try:
            while (item := self._next()) is not None:
                record, has_place = item
                self._store(record)
                del item, record  # the picture's memory is free before its place is
                if has_place:
                    self._places.put(None)
            self._end()
        finally:
            self._done.set()

    def _next(self) -> tuple[PairRecord, bool] | None:
        """Return what is to be written next; None at the end, or when nobody can say so any more.

        An interrupt may come before the `with` block is entered or while it is left: then the
        owner's thread ends without a word.
        """
        while True:
            try:
                return self._queue.get(timeout=_LOOK_UP_S)
            except queue.Empty:
                if not self._owner.is_alive():
                    return None
                if not self._stopped:
                    self._guard("cannot record what came", self._sink.hand_over)

    def _store(self, record: PairRecord) -> None:
        if self._stopped:
            return
        kept = without_pictures(record, DISK_FULL) if self._sink.full else record
        self._guard(f"cannot record trigger {record.trigger}", lambda: self._sink.take(kept))
        if self._sink.full:
            self._fail(
                DiskFull(
                    f"the disk is full at trigger {record.trigger}; {self.path} is finalised "
                    "and kept; free space or name another folder with --out"
                )
            )

    def _end(self) -> None:
        if not self._torn:
            self._guard("cannot end the recording", self._sink.finish)
        self._guard("cannot end the recording", self._sink.close_file)
        if self._torn:
            self._guard("cannot repair the recording", lambda: recover(self.path))
        else:
            self._guard("cannot describe the recording", lambda: bag.describe(self.path))

    def _guard(self, what: str, work: Callable[[], object]) -> None:
        try:
            work()
        except Exception as error:
            self._stop(what, error)

    def _stop(self, what: str, error: Exception) -> None:
        """Take nothing more; after an OSError the file ends in an unfinished record."""
        self._stopped = True
        self._torn |= isinstance(error, OSError)
        why = (error.strerror if isinstance(error, OSError) else None) or error
        self._fail(RecordingError(f"{what} in {self.path}: {why}; what was written before is kept"))

    def _fail(self, failure: RecordingError) -> None:
        """Keep the first failure; after a full disk, which ends well, a worse one too."""
        if self._failure is None:
            self._failure = failure
        elif isinstance(self._failure, DiskFull) and not isinstance(failure, DiskFull):
            self._failure, self._reported = failure, False


def without_pictures(record: PairRecord, cause: str) -> PairRecord:
    """Return `record` with its frames lost to `cause`, and no depth; earlier causes stay."""
    shot: Pair[Frame | Lost] = Pair(
        *(Lost(s.sequence, cause) if isinstance(s, Frame) else s for s in record.shot)
    )
    truth = record.truth and dataclasses.replace(record.truth, depth_m=None)
    return dataclasses.replace(
        record, shot=shot, offset_ns=None, cause=record.cause or cause, truth=truth
    )
