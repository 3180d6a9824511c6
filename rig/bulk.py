"""One map for long work in pieces: over the processes of this computer, or over a Dask cluster.

What is mapped is a picklable function over picklable tasks with names; the results are the same
wherever they are worked out. A task that fails is tried once more behind the others, and when
that fails too the error names it.
"""

from __future__ import annotations

import ctypes
import logging
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Generic, TypeVar

import cv2
import numba

from rig.core.errors import RigError, UsageError

log = logging.getLogger(__name__)

Task = TypeVar("Task")
Result = TypeVar("Result")

_CONNECT_S = 10
_PR_SET_PDEATHSIG = 1


class BulkError(RigError):
    """Some of many tasks failed, twice each; the message names them."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Where the work is done: in `processes`, one a core when None, or by a Dask scheduler.

    `dask` is the scheduler's address, such as tcp://10.0.0.5:8786. Its workers need the rig
    installed and see the same files under the same names.
    """

    processes: int | None = None
    dask: str = ""

    def __post_init__(self) -> None:
        if self.processes is not None and self.processes < 1:
            raise UsageError(f"the number of processes must be at least 1, got {self.processes}")
        if self.processes is not None and self.dask:
            raise UsageError(
                f"{self.processes} local processes and --dask exclude each other: a cluster has "
                "workers of its own"
            )

    @property
    def count(self) -> int:
        """Return the number of local processes."""
        return self.processes or len(os.sched_getaffinity(0))


LOCAL = Workers()
ALONE = Workers(processes=1)
"""This process and no other."""


@dataclass(frozen=True, slots=True)
class _Done(Generic[Result]):
    """A task's result, or the exception that it ended with."""

    name: str
    result: Result | None
    error: Exception | None


def run_tasks(
    work: Callable[[Task], Result], tasks: Mapping[str, Task], workers: Workers = LOCAL
) -> Iterator[tuple[str, Result]]:
    """Yield (name, result) of each task as it finishes, in whatever order.

    Raises BulkError, after all others are done, naming the tasks that failed twice; of a single
    task its own error. Stopping early, by Ctrl-C too, ends the other processes.
    """
    failed: dict[str, Exception] = {}
    for done in _try_all(work, tasks, workers):
        if done.error is None:
            yield done.name, done.result  # type: ignore[misc]
        else:
            log.warning("%s failed (%s); trying it once more", done.name, _said(done.error))
            failed[done.name] = done.error
    for done in _second_try(work, {name: tasks[name] for name in failed}, failed, workers):
        if done.error is None:
            del failed[done.name]
            yield done.name, done.result  # type: ignore[misc]
        else:
            failed[done.name] = done.error
    _raise(failed, len(tasks))


def run_all(
    work: Callable[[Task], Result], tasks: Sequence[Task], workers: Workers = LOCAL
) -> Iterator[Result]:
    """Yield the result of each task as it finishes; tasks are named by their words."""
    for _, result in run_tasks(work, {str(task): task for task in tasks}, workers):
        yield result


def _second_try(
    work: Callable[[Task], Result],
    tasks: Mapping[str, Task],
    failed: Mapping[str, Exception],
    workers: Workers,
) -> Iterator[_Done[Result]]:
    """Try again; where a process was killed each by itself, so that it takes no other with it."""
    suspects = [name for name in tasks if isinstance(failed[name], BrokenProcessPool)]
    others = {name: task for name, task in tasks.items() if name not in suspects}
    if others:
        yield from _try_all(work, others, workers)
    for name in suspects:
        yield from _in_processes(work, {name: tasks[name]}, 1)


def _raise(failed: Mapping[str, Exception], total: int) -> None:
    if not failed:
        return
    if total == 1:
        raise next(iter(failed.values()))
    reasons = "; ".join(f"{name}: {_said(error)}" for name, error in failed.items())
    raise BulkError(f"{len(failed)} of {total} tasks failed twice: {reasons}")


def _said(error: Exception) -> str:
    if isinstance(error, RigError):
        return str(error)
    if isinstance(error, BrokenProcessPool):
        return "its process was killed, perhaps for want of memory"
    return f"{type(error).__name__}: {error}"


def _try_all(
    work: Callable[[Task], Result], tasks: Mapping[str, Task], workers: Workers
) -> Iterator[_Done[Result]]:
    if workers.dask:
        yield from _on_cluster(work, tasks, workers.dask)
    elif min(workers.count, len(tasks)) <= 1:
        for name, task in tasks.items():
            yield _here(work, name, task)
    else:
        yield from _in_processes(work, tasks, min(workers.count, len(tasks)))


def _here(work: Callable[[Task], Result], name: str, task: Task) -> _Done[Result]:
    try:
        with _one_thread():
            return _Done(name, work(task), None)
    except Exception as error:
        return _Done(name, None, error)


def _in_processes(
    work: Callable[[Task], Result], tasks: Mapping[str, Task], count: int
) -> Iterator[_Done[Result]]:
    before = set(multiprocessing.active_children())
    fresh = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(count, mp_context=fresh, initializer=_begin)
    try:
        names = {pool.submit(work, task): name for name, task in tasks.items()}
        for future in as_completed(names):
            yield _outcome(names.pop(future), future)
        pool.shutdown()
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - before:
            child.kill()  # a drive takes any other signal for the end of itself alone
        raise


def _outcome(name: str, future: Future[Result]) -> _Done[Result]:
    error = future.exception()
    if error is None:
        return _Done(name, future.result(), None)
    if not isinstance(error, Exception):
        raise error
    return _Done(name, None, error)


def _on_cluster(
    work: Callable[[Task], Result], tasks: Mapping[str, Task], address: str
) -> Iterator[_Done[Result]]:
    try:
        dask: Any = import_module("distributed")
    except ImportError:
        raise RigError("--dask needs the extra: pip install 'exposure-rig[dask]'") from None
    if ":" not in address:
        raise UsageError(f"--dask {address}: name host and port, such as tcp://10.0.0.5:8786")
    try:
        client = dask.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as problem:
        raise RigError(
            f"--dask {address}: no scheduler answers ({problem}); start one with: dask scheduler"
        ) from problem
    pending = {client.submit(_threaded, work, task, pure=False): n for n, task in tasks.items()}
    try:
        for future in dask.as_completed(list(pending), loop=client.loop):
            error = future.exception()
            yield _Done(pending.pop(future), None if error else future.result(), error)
    finally:
        client.cancel(list(pending), force=True)
        client.close()


def _threaded(work: Callable[[Task], Result], task: Task) -> Result:
    with _one_thread():
        return work(task)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Keep numba and OpenCV to one thread meanwhile, as in the other processes."""
    before = numba.get_num_threads(), cv2.getNumThreads()
    numba.set_num_threads(1)
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before[0])
        cv2.setNumThreads(before[1])


def _begin() -> None:
    """Leave Ctrl-C to the parent, end when it ends, however, and use one thread a process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    numba.set_num_threads(1)
    cv2.setNumThreads(1)
