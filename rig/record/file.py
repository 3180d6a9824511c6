"""The file below the MCAP writer: kept by the disk as it grows, with room kept back for its end."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from rig.record.backing import open_new
from rig.record.cdr import Buffer

_FULL = (errno.ENOSPC, errno.EDQUOT)
_SYNC_EVERY_S = 0.5
_M_MMAP_THRESHOLD, _M_TRIM_THRESHOLD, _M_TOP_PAD = -3, -1, -2
_MALLOC_OPTIONS = (
    (_M_MMAP_THRESHOLD, 32 << 20),
    (_M_TRIM_THRESHOLD, 256 << 20),
    (_M_TOP_PAD, 64 << 20),
)


def keep_picture_buffers() -> None:
    """Let glibc reuse memory of picture size instead of asking the kernel for each one.

    Blocks of some megabytes are otherwise mapped, zeroed and unmapped for every picture, which
    costs a recorder more than everything else it does. Holds for the whole process.
    """
    mallopt = ctypes.CDLL(None).mallopt
    for parameter, size in _MALLOC_OPTIONS:
        mallopt(parameter, size)


def reserve_path(path: Path) -> Path:
    """Return the file that keeps room for `path` while it is written."""
    return path.with_name(path.name + ".reserve")


class Reserve:
    """Disk space kept back in a file of its own, so that a recording can end on a full disk.

    It is locked while the recording is written: a reserve that nobody holds was left by a run
    that was killed.
    """

    def __init__(self, path: Path) -> None:
        """Create `path`; raises OSError when it exists."""
        self._path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        fcntl.flock(self._fd, fcntl.LOCK_EX)
        self._size = 0

    def hold(self, size: int) -> None:
        """Keep at least `size` bytes back; raises OSError when the disk has not that much."""
        if size > self._size:
            os.posix_fallocate(self._fd, 0, size)
            self._size = size

    def release(self) -> None:
        """Give the space back to the disk; a second call does nothing."""
        if self._fd >= 0:
            self._path.unlink(missing_ok=True)
            os.close(self._fd)
            self._fd = -1


def is_held(recording: Path) -> bool:
    """Return whether some process is writing `recording` now."""
    try:
        fd = os.open(reserve_path(recording), os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(fd)
    return False


def give_back(recording: Path) -> None:
    """Give the room that a killed recorder kept back to the disk; the mark that it was remains."""
    with suppress(FileNotFoundError):
        os.truncate(reserve_path(recording), 0)


def free_bytes(folder: Path) -> int:
    """Return the room on the disk of `folder`, which need not exist yet; raises OSError."""
    while not folder.exists():
        folder = folder.parent
    room = os.statvfs(folder)
    return room.f_bavail * room.f_frsize


class RecordingFile:
    """A new file that writes every byte it is given, or raises.

    When the disk fills up, the reserve is released, `full` becomes true and writing goes on: the
    caller then has that much room to end the recording. A `live` recording cannot be repeated, so
    it goes past the page cache where that is possible, and a thread makes the disk keep it twice
    a second.
    """

    def __init__(self, path: Path, *, reserve_bytes: int, live: bool) -> None:
        """Create `path`; raises OSError when it exists or the disk cannot hold the reserve."""
        self.full = False
        self._path = path
        self._position = 0
        self._open = True
        self._syncer: _Syncer | None = None
        self._backing = open_new(path, self._make_room, direct=live)
        try:
            self._reserve = Reserve(reserve_path(path))
        except OSError:
            os.close(self._backing.fd)
            path.unlink()
            raise
        try:
            self._reserve.hold(reserve_bytes)
            if live:
                _sync_folder(path.parent)
        except OSError:
            self.discard()
            raise
        if live:
            self._syncer = _Syncer(self._backing.fd)

    def write(self, parts: Sequence[Buffer]) -> None:
        """Write all of `parts` one after the other, without joining them."""
        if self._syncer is not None:
            self._syncer.check()
        views = [memoryview(part).cast("B") for part in parts if len(part)]
        self._backing.append(views)
        self._position += sum(map(len, views))

    def hold(self, reserve_bytes: int) -> None:
        """Keep that much room back from now on; without it the disk counts as full."""
        if self.full:
            return
        try:
            self._reserve.hold(reserve_bytes)
        except OSError as error:
            self._make_room(error)

    def settle(self) -> None:
        """Wait until the disk keeps all that was written; raises OSError."""
        os.fdatasync(self._backing.fd)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._position

    def close(self) -> None:
        """Bring everything to the disk and release the reserve; raises OSError."""
        if not self._open:
            return
        self._open = False
        self._end_sync()
        fd = self._backing.fd
        try:
            os.ftruncate(fd, self._position)
            os.fsync(fd)
            if self._syncer is not None:
                self._syncer.check()  # a disk tells of an error once: perhaps to that thread
        finally:
            self._reserve.release()
            os.close(fd)

    def discard(self) -> None:
        """Take the file away again."""
        self._open = False
        self._end_sync()
        os.close(self._backing.fd)
        self._path.unlink()
        self._reserve.release()

    def _end_sync(self) -> None:
        if self._syncer is not None:
            self._syncer.stop()

    def _make_room(self, error: OSError) -> None:
        """Give the reserve back when the disk is full; raises `error` when that cannot help."""
        if error.errno not in _FULL or self.full:
            raise error
        self._reserve.release()
        self.full = True


def _sync_folder(folder: Path) -> None:
    """Make the disk keep the names of new files."""
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


class _Syncer:
    """A thread that brings a file to the disk, so that its writer never waits for that."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._ended = threading.Event()
        self._error: OSError | None = None
        self._thread = threading.Thread(target=self._work, name="rig-sync", daemon=True)
        self._thread.start()

    def check(self) -> None:
        """Raise the OSError that the disk answered with, if there was one."""
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        """End the thread."""
        self._ended.set()
        self._thread.join()

    def _work(self) -> None:
        try:
            while not self._ended.wait(_SYNC_EVERY_S):
                os.fdatasync(self._fd)
        except OSError as error:
            self._error = error
