"""The loop and the pair, over cameras that do exactly what the test says."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import CameraError, GrabTimeout
from rig.core.protocols import Clock
from rig.core.types import (
    MAX_PAIR_OFFSET_NS,
    THESIS_LIMITS,
    Command,
    Decision,
    Frame,
    Intrinsics,
    Limits,
    Lost,
    Pair,
    PairRecord,
    Settings,
    Truth,
)
from rig.loop import run_pair
from rig.pair import CameraPair


@dataclass
class ScriptedCamera:
    """Takes a blank picture for each trigger, except where the script says otherwise."""

    serial: str
    clock: VirtualClock
    missing: frozenset[int] = frozenset()
    offset_ns: int = 0
    late: dict[int, int] = field(default_factory=dict)
    limits: Limits = THESIS_LIMITS
    settings: Settings = Settings(1_000.0, 0.0)
    count: int = -1
    log: list[str] = field(default_factory=list)
    partner: ScriptedCamera | None = None

    def apply(self, command: Command) -> Command:
        assert isinstance(command, Settings)
        self.settings = command.clamp(self.limits)
        self.log.append("apply")
        return self.settings

    def trigger(self) -> None:
        self.log.append("trigger")
        self.count += 1
        if self.partner is not None:
            self.partner.trigger()

    def grab(self, timeout_s: float) -> Frame:
        self.log.append("grab")
        if self.count in self.missing:
            raise GrabTimeout(f"camera {self.serial}: nothing in {timeout_s} s")
        sequence = self.late.pop(self.count, self.count)
        start_ns = self.clock.now_ns() + self.offset_ns
        image = np.full((4, 4), 7, np.uint8)
        return Frame(image, "mono8", sequence, start_ns, start_ns, self.settings)

    def close(self) -> None:
        self.log.append("close")


@dataclass
class ScriptedSource:
    """Two scripted cameras with the primary's pulse wired to the secondary."""

    cameras: Pair[ScriptedCamera]
    clock: Clock
    rate_hz: float | None = 10.0
    decision_ms: float = 0.0
    address: str = "test:"
    real_time: bool = False
    drive_triggers: int | None = None
    world_version: str = ""
    intrinsics: Pair[Intrinsics] = Pair(
        Intrinsics(4, 4, 4.0, 4.0, 2.0, 2.0), Intrinsics(4, 4, 4.0, 4.0, 2.0, 2.0)
    )

    def pose_index(self, trigger: int) -> int:
        return trigger

    def truth(self, trigger: int) -> Truth | None:
        return None

    def close(self) -> None: ...


@dataclass
class Counting:
    """Asks for 100 us more each time, on both sides."""

    names: Pair[str] = Pair("a", "b")
    asked_us: float = 1_000.0

    def reset(self, limits: Pair[Limits]) -> Pair[Command]:
        return Pair(Settings(self.asked_us, 0.0), Settings(self.asked_us, 0.0))

    def decide(self, frames: Pair[Frame]) -> Pair[Decision]:
        self.asked_us += 100.0
        decision = Decision("a", Settings(self.asked_us, 0.0), 0.0)
        return Pair(decision, decision)


@dataclass
class Memory:
    """Keeps the records."""

    records: list[PairRecord] = field(default_factory=list)

    def write(self, record: PairRecord) -> None:
        self.records.append(record)

    def __enter__(self) -> Memory:
        return self

    def __exit__(self, *exc: object) -> None: ...


def make_source(**secondary: object) -> ScriptedSource:
    clock = VirtualClock()
    follower = ScriptedCamera("2", clock, **secondary)  # type: ignore[arg-type]
    leader = ScriptedCamera("1", clock, partner=follower)
    return ScriptedSource(Pair(leader, follower), clock)


def drive(source: ScriptedSource, triggers: int) -> list[PairRecord]:
    memory = Memory()
    run_pair(source, Counting(), memory, lambda done: done < triggers)  # type: ignore[arg-type]
    return memory.records


def asked_us(records: Iterable[PairRecord]) -> list[float]:
    return [r.asked.primary.exposure_us for r in records if isinstance(r.asked.primary, Settings)]


def test_a_decision_reaches_the_very_next_frame() -> None:
    records = drive(make_source(), 4)
    assert asked_us(records) == [1_000.0, 1_100.0, 1_200.0, 1_300.0]
    for record in records:
        for frame, asked in zip(record.shot, record.asked, strict=True):
            assert isinstance(frame, Frame) and frame.used == asked


def test_both_cameras_are_set_before_the_trigger_and_read_after() -> None:
    source = make_source()
    drive(source, 1)
    assert source.cameras.primary.log == ["apply", "trigger", "grab"]


def test_a_camera_that_the_rig_leaves_nothing_is_named() -> None:
    source = make_source(limits=Limits(exposure_us=(10.0, 60.0)))
    with pytest.raises(
        CameraError, match=r"2: takes 10\.\.60 us .* 75\.\.30000 us .* leave nothing"
    ):
        drive(source, 1)


def test_triggers_keep_their_pace() -> None:
    source = make_source()
    drive(source, 6)
    assert source.clock.now_ns() == 500_000_000


def test_a_decision_that_costs_time_delays_only_what_it_must() -> None:
    source = make_source()
    source.decision_ms = 40.0
    drive(source, 3)
    assert source.clock.now_ns() == pytest.approx(240_000_000)


def test_a_lost_frame_repeats_the_settings_and_is_recorded() -> None:
    records = drive(make_source(missing=frozenset({1})), 4)
    assert [record.complete for record in records] == [True, False, True, True]
    assert asked_us(records) == [1_000.0, 1_100.0, 1_100.0, 1_200.0]
    lost = records[1].shot.secondary
    assert lost == Lost(1, "secondary: no frame in time")
    assert isinstance(records[1].shot.primary, Frame), "the partner's frame is kept"
    assert records[1].decisions == Pair(None, None)


def test_exposures_that_began_apart_are_no_pair() -> None:
    (record,) = drive(make_source(offset_ns=MAX_PAIR_OFFSET_NS + 1), 1)
    assert not record.complete
    assert record.offset_ns == MAX_PAIR_OFFSET_NS + 1


def test_a_frame_that_ran_ahead_is_never_paired() -> None:
    (record,) = drive(make_source(late={0: 5}), 1)
    assert record.shot.secondary == Lost(0, "secondary: trigger count ran ahead")


@pytest.mark.parametrize("stop_after", [0, 3])
def test_the_loop_ends_when_told(stop_after: int) -> None:
    keep: Callable[[int], bool] = lambda done: done < stop_after  # noqa: E731
    memory = Memory()
    summary = run_pair(make_source(), Counting(), memory, keep)  # type: ignore[arg-type]
    assert summary.triggers == len(memory.records) == stop_after


def test_a_stale_frame_is_passed_over() -> None:
    source = make_source(late={1: 0})
    pair = CameraPair(source)  # type: ignore[arg-type]
    pair.shoot()
    shot = pair.shoot()
    assert shot.cause == ""
