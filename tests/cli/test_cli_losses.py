"""A drive whose disk is too slow says so with its exit code and its count of pairs."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from rig.cli.drive import make_header, record_drive
from rig.cli.exits import LOSSES
from rig.cli.terminal import Terminal
from rig.controllers.policies import SweepPolicy, exposure_sweep
from rig.core.protocols import Source
from rig.core.types import Pair, PairRecord
from rig.drivers.registry import open_source
from rig.record import sink, writer
from rig.record.verify import verify
from rig.record.writer import QUEUE_FULL


class Live:
    """A simulated pair that waits for nobody."""

    real_time = True

    def __init__(self, simulated: Source) -> None:
        self._simulated = simulated

    def __getattr__(self, name: str) -> Any:
        return getattr(self._simulated, name)


def test_pairs_that_the_recorder_dropped_are_losses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = sink.Sink.take

    def take_slowly(self: sink.Sink, record: PairRecord) -> None:
        time.sleep(0.1)
        take(self, record)

    monkeypatch.setattr(writer, "_WAITING_REAL_TIME", 2)
    monkeypatch.setattr(sink.Sink, "take", take_slowly)
    source = Live(open_source("sim:wall?size=320x240", seed=0))
    header = make_header(source, 0, Pair("a", "b"), options={}, models={})
    policy = SweepPolicy(exposure_sweep(4, 0.0))
    drive = record_drive(source, policy, header, tmp_path / "run", 12, Terminal(quiet=True))
    found = verify(tmp_path / "run")
    assert found.lost[QUEUE_FULL] > 0
    assert drive.exit_code == LOSSES
    assert (drive.run.triggers, drive.run.complete) == (12, found.pairs)
