"""A controller alone takes the same pictures, and is judged alike, as in a race."""

from __future__ import annotations

import pytest

from rig.controllers.policies import RacePolicy
from rig.controllers.registry import make_controller
from rig.core.clock import SystemClock
from rig.core.errors import UsageError
from rig.core.types import Frame, PairRecord
from rig.drivers.registry import open_source
from rig.evaluation.series import measure
from rig.evaluation.statistics import BLIND_BELOW, WARM_UP_PAIRS, counted, inlier_statistics
from rig.experiments.solo import run_solo
from rig.loop import run_pair

ADDRESS = "sim:road?size=320x240&seed=0"
FRAMES = 16


class Memory:
    """Keeps the records of a race."""

    def __init__(self) -> None:
        self.records: list[PairRecord] = []

    def write(self, record: PairRecord) -> None:
        self.records.append(record)


@pytest.mark.parametrize("spec", ["mean", "aeag", "shin:tolerance=high"])
def test_alone_is_what_it_is_in_a_race(spec: str) -> None:
    named = [make_controller(name, seed=0, networks={}) for name in (spec, "fixed")]
    source, memory = open_source(ADDRESS, seed=0), Memory()
    policy = RacePolicy(named[0], named[1], SystemClock())
    run_pair(source, policy, memory, lambda trigger: trigger < FRAMES)  # type: ignore[arg-type]
    raced = [record.shot.primary for record in memory.records]
    assert all(isinstance(frame, Frame) for frame in raced)
    solo = run_solo(
        ADDRESS,
        [make_controller(name, seed=0, networks={}) for name in ("fixed", spec)],
        seed=0,
        frames=FRAMES,
    )[1]
    assert [frame.used for frame in raced if isinstance(frame, Frame)] == list(solo.used)
    raced_series = measure(memory.records, intrinsics=source.intrinsics)
    camera = raced_series.cameras.primary
    assert set(solo.inliers) == {"orb", "viso2"}
    for name, statistics in solo.inliers.items():
        inliers = counted(raced_series.trigger, camera.inliers[name])
        assert statistics == inlier_statistics(inliers, BLIND_BELOW[name])
        assert statistics.median and statistics.median > 20
    assert camera.odometry is not None
    told = [(step.trigger, step.inliers) for step in camera.odometry.since(WARM_UP_PAIRS)]
    assert [(step.trigger, step.inliers) for step in solo.steps] == told
    assert len(told) == FRAMES - WARM_UP_PAIRS


def test_only_a_simulation_can_be_driven_alone() -> None:
    with pytest.raises(UsageError, match="only a sim: address"):
        run_solo("aravis:1,2", [], seed=0)
