"""Disks that misbehave, in place of `os` in the recording's file object."""

from __future__ import annotations

import errno
import os
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
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


WRITES = ("writev", "pwrite")
CALLS = (*WRITES, "open", "posix_fallocate", "fdatasync", "fsync", "ftruncate", "close")


class Fails(RealOs):
    """Answers the calls that `at` names by number, counted from 0, with `error`.

    Only calls of `names` are counted. A `close` that fails has closed, as on Linux.
    """

    def __init__(self, at: range, error: int, names: Sequence[str] = WRITES) -> None:
        self.at = at
        self.error = error
        self.names = names
        self.count = 0

    def __getattr__(self, name: str) -> Any:
        real = getattr(os, name)
        if name not in self.names:
            return real

        def call(*arguments: Any) -> Any:
            self.count += 1
            if self.count - 1 not in self.at:
                return real(*arguments)
            if name == "close":
                real(*arguments)
            raise OSError(self.error, os.strerror(self.error))

        return call


def once(at: int) -> range:
    """Return the one call number `at`."""
    return range(at, at + 1)


class ShortWrites(RealOs):
    """Takes no more than `most` bytes at a time, past the page cache whole blocks of them."""

    def __init__(self, most: int) -> None:
        self.most = most

    def writev(self, fd: int, views: Views) -> int:
        return os.write(fd, b"".join(views)[: self.most])

    def pwrite(self, fd: int, data: memoryview, start: int) -> int:
        return os.pwrite(fd, data[: max(4096, self.most - self.most % 4096)], start)


@dataclass(frozen=True, slots=True)
class Written:
    """Some bytes that were given to a file."""

    file: str
    start: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Synced:
    """The disk keeps of a file what was written before event number `before`."""

    file: str
    before: int


@dataclass(slots=True)
class Journal:
    """Remembers every write and every sync in order; stands in for `os`."""

    events: list[Written | Synced] = field(default_factory=list)

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)

    def writev(self, fd: int, views: Views) -> int:
        start = os.lseek(fd, 0, os.SEEK_CUR)
        written = os.writev(fd, views)
        self.events.append(Written(_name(fd), start, b"".join(views)[:written]))
        return written

    def pwrite(self, fd: int, data: memoryview, start: int) -> int:
        written = os.pwrite(fd, data, start)
        self.events.append(Written(_name(fd), start, bytes(data[:written])))
        return written

    def fdatasync(self, fd: int) -> None:
        self._sync(fd, os.fdatasync)

    def fsync(self, fd: int) -> None:
        self._sync(fd, os.fsync)

    def _sync(self, fd: int, sync: Callable[[int], None]) -> None:
        name, before = _name(fd), len(self.events)
        sync(fd)
        self.events.append(Synced(name, before))

    def unsure(self, events: int) -> set[int]:
        """Return which of the first `events` are writes that no sync among them covers."""
        until = {e.file: e.before for e in self.events[:events] if isinstance(e, Synced)}
        return {
            number
            for number, each in enumerate(self.events[:events])
            if isinstance(each, Written) and number >= until.get(each.file, 0)
        }

    def state(self, events: int, draw: random.Random) -> dict[str, bytes]:
        """Return the files as lost power may leave them after that many events.

        Of what was not synced some writes reached the disk, some of them with their first bytes
        only; the others left what was there, zeros, or nothing at the end.
        """
        unsure = self.unsure(events)
        files: dict[str, bytearray] = {}
        for number, each in enumerate(self.events[:events]):
            if isinstance(each, Written):
                torn = draw.choice([None, None, 0, draw.randrange(len(each.data))])
                reached = each.data[:torn] if number in unsure else each.data
                data = files.setdefault(each.file, bytearray())
                data.extend(bytes(max(0, each.start + len(reached) - len(data))))
                data[each.start : each.start + len(reached)] = reached
        return {name: bytes(data) for name, data in files.items()}


def _name(fd: int) -> str:
    return Path(f"/proc/self/fd/{fd}").readlink().name
