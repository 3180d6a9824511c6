"""Long work in pieces, in one process a core."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

import cv2
import numba

from rig.core.errors import UsageError

Piece = TypeVar("Piece")
Result = TypeVar("Result")


def process_count(wanted: int | None) -> int:
    """Return `wanted`, or the number of cores that this process may use; both at least 1."""
    if wanted is not None and wanted < 1:
        raise UsageError(f"--processes must be at least 1, got {wanted}")
    return wanted or len(os.sched_getaffinity(0))


def in_processes(
    work: Callable[[Piece], Result], pieces: Sequence[Piece], processes: int
) -> Iterator[Result]:
    """Yield the result of each piece, in whatever order they finish.

    With one process the work is done in this one. `work` and its pieces must be picklable. When
    the caller stops early, by Ctrl-C too, the other processes are ended.
    """
    if min(processes, len(pieces)) <= 1:
        with one_thread():
            yield from map(work, pieces)
        return
    fresh = multiprocessing.get_context("spawn")
    with fresh.Pool(min(processes, len(pieces)), _begin) as pool:
        yield from pool.imap_unordered(work, pieces)


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep numba and OpenCV to one thread meanwhile."""
    before = numba.get_num_threads(), cv2.getNumThreads()
    numba.set_num_threads(1)
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before[0])
        cv2.setNumThreads(before[1])


def _begin() -> None:
    """Leave Ctrl-C to the parent, which ends its children, and use one thread a process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    numba.set_num_threads(1)
    cv2.setNumThreads(1)
