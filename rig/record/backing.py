"""How the bytes of a recording reach the disk: through the page cache, or past it."""

from __future__ import annotations

import errno
import mmap
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

BLOCK_BYTES = 4096
_STAGE_BYTES = 4 << 20
_IOV_MAX = 1024

MakeRoom = Callable[[OSError], None]
"""Called with what a write raised: returns when it is worth trying again, else raises it."""


class Backing(Protocol):
    """Appends bytes to an open file."""

    fd: int

    def append(self, views: Sequence[memoryview]) -> None:
        """Write all of `views` one after the other; raises OSError."""
        ...


def open_new(path: Path, make_room: MakeRoom, *, direct: bool) -> Backing:
    """Create `path`; `direct` goes past the page cache where the file system can do that.

    Raises OSError, FileExistsError among them.
    """
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
    if direct:
        try:
            return Direct(os.open(path, flags | os.O_DIRECT, 0o644), make_room)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP):
                raise
            path.unlink(missing_ok=True)
    return Buffered(os.open(path, flags, 0o644), make_room)


class Buffered:
    """Gathers the parts in the kernel: they are copied once, into the page cache."""

    def __init__(self, fd: int, make_room: MakeRoom) -> None:
        self.fd = fd
        self._make_room = make_room

    def append(self, views: Sequence[memoryview]) -> None:
        """Write all of `views` one after the other; raises OSError."""
        for start in range(0, len(views), _IOV_MAX):
            self._write(list(views[start : start + _IOV_MAX]))

    def _write(self, views: list[memoryview]) -> None:
        while views:
            try:
                written = os.writev(self.fd, views)
                if written == 0:
                    raise OSError(errno.EIO, os.strerror(errno.EIO))
            except OSError as error:
                self._make_room(error)
                continue
            views = _after(views, written)


class Direct:
    """Gathers the parts in an aligned buffer that the disk takes from memory by itself.

    A buffered write of pictures costs a processor several times as much and competes with its own
    flushing. Every `append` ends on the disk: its last, unfilled block is padded with zeros, and
    written again with what follows.
    """

    def __init__(self, fd: int, make_room: MakeRoom) -> None:
        self.fd = fd
        self._make_room = make_room
        self._stage = memoryview(mmap.mmap(-1, _STAGE_BYTES))
        self._start = 0
        self._filled = 0

    def append(self, views: Sequence[memoryview]) -> None:
        """Write all of `views` one after the other; raises OSError."""
        for view in views:
            at = 0
            while at < len(view):
                size = min(_STAGE_BYTES - self._filled, len(view) - at)
                self._stage[self._filled : self._filled + size] = view[at : at + size]
                self._filled += size
                at += size
                if self._filled == _STAGE_BYTES:
                    self._put()
        self._put()

    def _put(self) -> None:
        """Write what is staged in whole blocks; a last, unfilled one stays staged."""
        rest = self._filled % BLOCK_BYTES
        padding = -self._filled % BLOCK_BYTES
        self._stage[self._filled : self._filled + padding] = bytes(padding)
        self._write(self._filled + padding)
        whole = self._filled - rest
        self._stage[:rest] = bytes(self._stage[whole : self._filled])
        self._start += whole
        self._filled = rest

    def _write(self, size: int) -> None:
        done = 0
        while done < size:
            try:
                written = os.pwrite(self.fd, self._stage[done:size], self._start + done)
                if written == 0:
                    raise OSError(errno.EIO, os.strerror(errno.EIO))
            except OSError as error:
                self._make_room(error)
                continue
            done += written - written % BLOCK_BYTES


def _after(views: list[memoryview], written: int) -> list[memoryview]:
    """Return what is left of `views` behind the first `written` bytes."""
    for index, view in enumerate(views):
        if written < len(view):
            return [view[written:], *views[index + 1 :]]
        written -= len(view)
    return []
