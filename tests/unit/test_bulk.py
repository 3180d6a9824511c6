"""The same results in this process, in others and on a cluster; failed tasks are named."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import SyntheticRun

from rig.bulk import ALONE, BulkError, Workers, run_all, run_tasks
from rig.cli.evaluate import How, judge_run
from rig.core.errors import RecordingError, RigError, UsageError
from rig.models.targets import make_targets
from rig.record.writer import RecordWriter

TASKS = {f"number {n}": n for n in range(6)}


def squared(number: int) -> int:
    return number * number


def fails_once(folder: Path, number: int) -> int:
    """Fail the first time, in whatever process."""
    mark = folder / str(number)
    if not mark.exists():
        mark.touch()
        raise OSError(f"no answer for {number}")
    return number


def odd_fail(number: int) -> int:
    if number % 2:
        raise RecordingError(f"recording {number} is damaged")
    return number


def killed_at_three(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Return the address of a local cluster of two workers in processes of their own."""
    distributed = pytest.importorskip("distributed", reason="distributed is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cluster = distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        )
    yield cluster.scheduler_address
    cluster.close()


LOCAL_WAYS = [ALONE, Workers(2), Workers()]
SLOW_TWO = [ALONE, pytest.param(Workers(2), marks=pytest.mark.heavy)]


@pytest.mark.parametrize("workers", LOCAL_WAYS, ids=["alone", "two", "default"])
def test_results_are_the_same_everywhere(workers: Workers) -> None:
    assert dict(run_tasks(squared, TASKS, workers)) == {f"number {n}": n * n for n in range(6)}


def test_tasks_without_names_are_named_by_their_words() -> None:
    assert sorted(run_all(squared, [3, 1, 2], ALONE)) == [1, 4, 9]
    with pytest.raises(BulkError, match="1: recording 1 is damaged"):
        list(run_all(odd_fail, [0, 1, 2], ALONE))


@pytest.mark.parametrize("workers", LOCAL_WAYS[:2], ids=["alone", "two"])
def test_a_failed_task_is_tried_once_more(
    workers: Workers, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    found = dict(run_tasks(partial(fails_once, tmp_path), TASKS, workers))
    assert found == TASKS
    assert "number 4 failed (OSError: no answer for 4); trying it once more" in caplog.text


@pytest.mark.parametrize("workers", SLOW_TWO, ids=["alone", "two"])
def test_tasks_that_fail_twice_are_named_after_the_others_are_done(workers: Workers) -> None:
    found = {}
    with pytest.raises(BulkError) as failed:
        for name, result in run_tasks(odd_fail, TASKS, workers):
            found[name] = result
    assert found == {f"number {n}": n for n in (0, 2, 4)}
    assert "3 of 6 tasks failed twice" in str(failed.value)
    assert "number 3: recording 3 is damaged" in str(failed.value)


def test_a_single_task_fails_with_its_own_error() -> None:
    with pytest.raises(RecordingError, match="recording 1 is damaged"):
        list(run_tasks(odd_fail, {"one": 1}))


@pytest.mark.heavy
def test_a_killed_process_is_named_and_takes_no_other_task_with_it() -> None:
    found = {}
    with pytest.raises(BulkError, match="1 of 6 tasks failed twice: number 3: its process was"):
        for name, result in run_tasks(killed_at_three, TASKS, Workers(2)):
            found[name] = result
    assert sorted(found.values()) == [0, 1, 2, 4, 5]


def deaf(number: int) -> int:
    """End at once or, whatever one asks politely, in an hour."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    time.sleep(3600 * number)
    return number


def test_stopping_early_ends_processes_that_take_signals_for_themselves() -> None:
    before = set(multiprocessing.active_children())
    results = run_tasks(deaf, {"quick": 0, "slow": 1, "slower": 2}, Workers(2))
    assert next(results) == ("quick", 0)
    children = set(multiprocessing.active_children()) - before
    assert len(children) == 2
    results.close()  # type: ignore[attr-defined]
    wait_until(lambda: all(ended(child.pid) for child in children))


def test_processes_end_with_one_that_was_killed(tmp_path: Path) -> None:
    marks = [tmp_path / "0", tmp_path / "1"]
    script = f"""
import os, time
from pathlib import Path
from rig.bulk import Workers, run_all

def wait(mark):
    Path(mark).write_text(str(os.getpid()))
    time.sleep(3600)

if __name__ == "__main__":
    list(run_all(wait, {[str(mark) for mark in marks]}, Workers(2)))
"""
    (tmp_path / "parent.py").write_text(script)
    command = [sys.executable, str(tmp_path / "parent.py")]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as parent:
        wait_until(lambda: all(mark.exists() and mark.read_text() for mark in marks))
        parent.kill()
    children = [mark.read_text() for mark in marks]
    wait_until(lambda: all(map(ended, children)))


def ended(pid: object) -> bool:
    """Return whether a process has ended, whether or not anybody has asked for its exit status."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def wait_until(true: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 60
    while not true():
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


def test_what_cannot_be_meant_is_refused() -> None:
    with pytest.raises(UsageError, match="at least 1, got 0"):
        Workers(0)
    with pytest.raises(UsageError, match="exclude each other"):
        Workers(2, "tcp://127.0.0.1:8786")


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folders = [tmp_path_factory.mktemp("bulk") / f"run-{seed}" for seed in range(3)]
    for seed, folder in enumerate(folders):
        run = SyntheticRun(triggers=16, seed=seed)
        with RecordWriter(folder, run.header, real_time=False) as recorder:
            for record in run.records():
                recorder.write(record)
    return folders


def test_targets_are_the_same_in_processes(recordings: list[Path]) -> None:
    alone = make_targets(recordings, "feat", workers=ALONE)
    spread = make_targets(recordings, "feat", workers=Workers(2))
    assert alone.recordings == spread.recordings
    for name in alone.poses.__slots__:
        assert np.array_equal(getattr(alone.poses, name), getattr(spread.poses, name)), name


@pytest.mark.heavy
def test_a_damaged_recording_among_many_is_named(recordings: list[Path], tmp_path: Path) -> None:
    bad = tmp_path / "bad"
    bad.mkdir()
    (bad / "run.mcap").write_bytes(recordings[0].joinpath("run.mcap").read_bytes()[:-100])
    with pytest.raises(BulkError, match=r"1 of 3 tasks failed twice: .*bad: .*is damaged"):
        make_targets([recordings[0], bad, recordings[1]], "feat", workers=Workers(2))


@pytest.mark.heavy
def test_a_cluster_of_two_gives_the_same_and_names_what_fails(
    scheduler: str, recordings: list[Path], tmp_path: Path
) -> None:
    cluster = Workers(dask=scheduler)
    assert dict(run_tasks(squared, TASKS, cluster)) == dict(run_tasks(squared, TASKS, ALONE))
    assert dict(run_tasks(partial(fails_once, tmp_path), TASKS, cluster)) == TASKS
    with pytest.raises(BulkError, match="number 5: recording 5 is damaged"):
        list(run_tasks(odd_fail, TASKS, cluster))
    with pytest.raises(BulkError, match=r"1 of 6 tasks failed twice: number 3"):
        list(run_tasks(killed_at_three, TASKS, cluster))
    here, there = (make_targets(recordings, "feat", workers=w) for w in (ALONE, cluster))
    for name in here.poses.__slots__:
        assert np.array_equal(getattr(here.poses, name), getattr(there.poses, name)), name
    tasks = {str(path): path for path in recordings}
    work = partial(judge_run, How("orb", undistort=False))
    judged = dict(run_tasks(work, tasks, cluster))
    for name, summary in run_tasks(work, tasks, ALONE):
        assert judged[name].as_json() == summary.as_json()


def test_a_scheduler_that_is_not_there_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="distributed is not installed")
    monkeypatch.setattr("rig.bulk._CONNECT_S", 1)
    with pytest.raises(RigError, match="9: no scheduler answers"):
        list(run_tasks(squared, TASKS, Workers(dask="tcp://127.0.0.1:9")))
