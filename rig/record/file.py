"""The file below the MCAP writer: bounded page cache, and room kept back for a full disk."""

from __future__ import annotations

import ctypes
import errno
import os
import time
from pathlib import Path

from rig.record.cdr import Buffer

_FULL = (errno.ENOSPC, errno.EDQUOT)
_WINDOW_BYTES = 32 << 20
_SYNC_EVERY_S = 1.0
_M_MMAP_THRESHOLD, _M_TRIM_THRESHOLD, _M_TOP_PAD = -3, -1, -2
_MALLOC_OPTIONS = (
    (_M_MMAP_THRESHOLD, 32 << 20),
    (_M_TRIM_THRESHOLD, 256 << 20),
    (_M_TOP_PAD, 64 << 20),
)
_WRITE, _WAIT_WRITE_WAIT = 2, 1 | 2 | 4


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
    """Disk space kept back in a file of its own, so that a recording can end on a full disk."""

    def __init__(self, path: Path) -> None:
        """Create `path`; raises OSError when it exists."""
        self._path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._size = 0

    def hold(self, size: int) -> None:
        """Keep at least `size` bytes back; raises OSError when the disk has not that much."""
        if size > self._size:
            os.posix_fallocate(self._fd, 0, size)
            self._size = size

    def release(self) -> None:
        """Give the space back to the disk; a second call does nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._path.unlink(missing_ok=True)
            self._fd = -1


class RecordingFile:
    """A new file that writes every byte it is given, or raises.

    When the disk fills up, the reserve is released, `full` becomes true and writing goes on: the
    caller then has that much room to end the recording. A `live` recording cannot be repeated, so
    it is brought to the disk once a second; its pages are written back and dropped as it goes, so
    that the kernel never stalls it to flush gigabytes.
    """

    def __init__(self, path: Path, *, reserve_bytes: int, live: bool) -> None:
        """Create `path`; raises OSError when it exists or the disk cannot hold the reserve."""
        self.full = False
        self._position = 0
        self._flushed = 0
        self._synced_s = time.monotonic()
        self._sync_file_range = _sync_file_range() if live else None
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        try:
            self._reserve = Reserve(reserve_path(path))
            self.hold(reserve_bytes)
        except OSError:
            os.close(self._fd)
            path.unlink()
            raise
        if self.full:
            self.close()
            path.unlink()
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    def write(self, data: Buffer) -> int:
        """Write all of `data`."""
        view = memoryview(data).cast("B")
        size = len(view)
        while view:
            try:
                view = view[os.write(self._fd, view) :]
            except OSError as error:
                if error.errno not in _FULL or self.full:
                    raise
                self._become_full()
        self._position += size
        self._write_back()
        return size

    def hold(self, reserve_bytes: int) -> None:
        """Keep that much room back from now on; without it the disk counts as full."""
        if self.full:
            return
        try:
            self._reserve.hold(reserve_bytes)
        except OSError as error:
            if error.errno not in _FULL:
                raise
            self._become_full()

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._position

    def flush(self) -> None:
        """Do nothing: nothing is buffered here."""

    def close(self) -> None:
        """Bring everything to the disk and release the reserve; raises OSError."""
        self._reserve.release()
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            try:
                os.fsync(fd)
            finally:
                os.close(fd)

    def _become_full(self) -> None:
        self._reserve.release()
        self.full = True

    def _write_back(self) -> None:
        if self._sync_file_range is None:
            return
        if self._position - self._flushed >= _WINDOW_BYTES:
            self._drop_window(self._sync_file_range)
        now_s = time.monotonic()
        if now_s - self._synced_s >= _SYNC_EVERY_S:
            os.fdatasync(self._fd)
            self._synced_s = now_s

    def _drop_window(self, sync_file_range: ctypes._NamedFuncPointer) -> None:
        start, size = self._flushed, self._position - self._flushed
        sync_file_range(self._fd, start, size, _WRITE)
        before = max(0, start - _WINDOW_BYTES)
        if start:
            sync_file_range(self._fd, before, start - before, _WAIT_WRITE_WAIT)
            os.posix_fadvise(self._fd, before, start - before, os.POSIX_FADV_DONTNEED)
        self._flushed = self._position


def _sync_file_range() -> ctypes._NamedFuncPointer:
    function = ctypes.CDLL(None, use_errno=True).sync_file_range
    function.argtypes = [ctypes.c_int, ctypes.c_int64, ctypes.c_int64, ctypes.c_uint]
    return function
