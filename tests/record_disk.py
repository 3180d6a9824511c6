"""Disks that misbehave, in place of `os` in the recording's file object."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

Views = Sequence[memoryview]


class RealOs:
    """Passes everything on to `os`."""

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)


class SmallDisk(RealOs):
    """A disk of `capacity` bytes, or one that answers `error` once it has taken that many."""

    def __init__(self, capacity: int, error: int = errno.ENOSPC) -> None:
        self.capacity = capacity
        self.error = error
        self.used = 0
        self.held: dict[int, int] = {}

    def posix_fallocate(self, fd: int, start: int, size: int) -> None:
        grown = size - self.held.get(fd, 0)
        if self.error == errno.ENOSPC:
            if self.used + grown > self.capacity:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self.used += grown
        self.held[fd] = size

    def writev(self, fd: int, views: Views) -> int:
        room = self.capacity - self.used
        if room <= 0:
            raise OSError(self.error, os.strerror(self.error))
        written = os.write(fd, b"".join(views)[:room])
        self.used += written
        return written

    def pwrite(self, fd: int, data: memoryview, start: int) -> int:
        grown = start + len(data) - os.fstat(fd).st_size
        room = self.capacity - self.used
        if grown > 0 and room <= 0:
            raise OSError(self.error, os.strerror(self.error))
        short = max(0, grown - max(0, room))
        written = os.pwrite(fd, data[: len(data) - short - -short % 4096], start)
        self.used += max(0, grown - short)
        return written

    def close(self, fd: int) -> None:
        self.used -= self.held.pop(fd, 0) if self.error == errno.ENOSPC else 0
        os.close(fd)


class FailsOnce(RealOs):
    """Answers write number `at`, counted from 0, with `error`, once."""

    def __init__(self, at: int, error: int) -> None:
        self.at = at
        self.error = error
        self.writes = 0

    def writev(self, fd: int, views: Views) -> int:
        self._count()
        return os.writev(fd, views)

    def pwrite(self, fd: int, data: memoryview, start: int) -> int:
        self._count()
        return os.pwrite(fd, data, start)

    def _count(self) -> None:
        self.writes += 1
        if self.writes == self.at + 1:
            raise OSError(self.error, os.strerror(self.error))


class ShortWrites(RealOs):
    """Takes no more than `most` bytes at a time, past the page cache whole blocks of them."""

    def __init__(self, most: int) -> None:
        self.most = most

    def writev(self, fd: int, views: Views) -> int:
        return os.write(fd, b"".join(views)[: self.most])

    def pwrite(self, fd: int, data: memoryview, start: int) -> int:
        return os.pwrite(fd, data[: max(4096, self.most - self.most % 4096)], start)


@dataclass(slots=True)
class Journal:
    """Remembers every write and what was on the disk for sure; stands in for `os`."""

    writes: list[tuple[int, bytes]] = field(default_factory=list)
    synced: list[int] = field(default_factory=list)
    _size: int = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)

    def writev(self, fd: int, views: Views) -> int:
        written = os.writev(fd, views)
        self.writes.append((self._size, b"".join(views)[:written]))
        self._size += written
        return written

    def fdatasync(self, fd: int) -> None:
        count = len(self.writes)
        os.fdatasync(fd)
        self.synced.append(count)

    def state(self, writes: int, kept: set[int], torn: dict[int, int]) -> bytes:
        """Return a file as lost power may leave it after that many writes.

        Of what was not synced only the writes in `kept` reached the disk, those in `torn` with
        as many bytes; the others left zeros, or nothing at the end.
        """
        sure = max((count for count in self.synced if count <= writes), default=0)
        data = bytearray()
        for number, (start, content) in enumerate(self.writes[:writes]):
            if number < sure or number in kept:
                reached = content[: torn.get(number, len(content))] if number >= sure else content
                data.extend(bytes(max(0, start + len(reached) - len(data))))
                data[start : start + len(reached)] = reached
        return bytes(data)
