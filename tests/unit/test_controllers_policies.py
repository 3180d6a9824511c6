"""Policies time decisions, wire sides, and outlive every controller's failure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from rig.controllers.perturb import make_perturbation
from rig.controllers.policies import CollectPolicy, RacePolicy
from rig.controllers.registry import NamedController, make_controller
from rig.core.clock import VirtualClock
from rig.core.types import (
    THESIS_LIMITS,
    Auto,
    Command,
    Diagnostics,
    Frame,
    Limits,
    Pair,
    Settings,
)

BOTH = Pair(THESIS_LIMITS, THESIS_LIMITS)


@dataclass(slots=True)
class Scripted:
    """A controller that answers by script and takes its time."""

    answers: list[Any]
    clock: VirtualClock
    latency_s: float = 0.004
    seen: list[Frame] = field(default_factory=list)

    def reset(self, limits: Limits) -> Command:
        return Settings(1_000.0, 0.0)

    def step(self, frame: Frame) -> Command:
        self.seen.append(frame)
        self.clock.sleep_s(self.latency_s)
        answer = self.answers[len(self.seen) - 1]
        if isinstance(answer, Exception):
            raise answer
        if callable(answer):
            answer = answer()
        command: Command = answer
        return command

    def diagnostics(self) -> Diagnostics:
        return {"seen": float(len(self.seen))}


def frame(used: Settings, value: int = 100) -> Frame:
    return Frame(np.full((8, 8), value, np.uint8), "mono8", 0, 0, 0, used)


def frames(primary_us: float = 2_000.0, secondary_us: float = 3_000.0) -> Pair[Frame]:
    return Pair(frame(Settings(primary_us, 1.0)), frame(Settings(secondary_us, 2.0)))


def race(answers: list[Any]) -> tuple[RacePolicy, Scripted, Scripted]:
    clock = VirtualClock()
    left = Scripted(answers, clock)
    right = Scripted([Settings(50.0 + n, 0.0) for n in range(9)], clock, latency_s=0.5)
    policy = RacePolicy(
        NamedController("left", left, {}), NamedController("right", right, {}), clock
    )
    policy.reset(BOTH)
    return policy, left, right


def test_left_drives_the_primary_and_each_sees_its_own_frame() -> None:
    policy, left, right = race([Settings(700.0, 3.0)])
    pair = frames()
    decisions = policy.decide(pair)
    assert policy.names == Pair("left", "right")
    assert (left.seen, right.seen) == ([pair.primary], [pair.secondary])
    assert decisions.primary.command == Settings(700.0, 3.0)
    assert decisions.secondary.command == Settings(50.0, 0.0)
    assert [d.controller for d in decisions] == ["left", "right"]
    assert decisions.primary.diagnostics == {"seen": 1.0}


def test_each_decision_is_timed_alone() -> None:
    policy, _, _ = race([Settings(700.0, 3.0)])
    decisions = policy.decide(frames())
    assert [d.latency_ms for d in decisions] == pytest.approx([4.0, 500.0])


@pytest.mark.parametrize(
    ("failure", "why"),
    [
        (RuntimeError("lens cap"), "RuntimeError: lens cap"),
        (lambda: Settings(float("nan"), 0.0), "ValueError: exposure_us must be finite"),
        (lambda: Settings(700.0, float("inf")), "ValueError: gain_db must be finite"),
        (lambda: None, "TypeError: returned None, which is no command"),
    ],
)
def test_a_failing_controller_holds_and_says_why(
    failure: Exception | Callable[[], Any], why: str
) -> None:
    policy, _, _ = race([Settings(700.0, 3.0), failure, Settings(900.0, 3.0)])
    first, second, third = (policy.decide(frames()).primary for _ in range(3))
    assert first.command == second.command == Settings(700.0, 3.0)
    assert why in str(second.diagnostics["held"])
    assert second.latency_ms == pytest.approx(4.0)
    assert (third.command, "held" in third.diagnostics) == (Settings(900.0, 3.0), False)


def test_a_failure_at_the_first_frame_holds_the_start() -> None:
    policy, _, right = race([RuntimeError("at once")])
    decisions = policy.decide(frames())
    assert decisions.primary.command == Settings(1_000.0, 0.0)
    assert decisions.secondary.command == Settings(50.0, 0.0)
    assert len(right.seen) == 1


def test_a_failure_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    policy, _, _ = race([RuntimeError("again")] * 3)
    for _ in range(3):
        policy.decide(frames())
    assert caplog.messages == ["left holds its last command: RuntimeError: again"]


def collect(name: str, leader: str = "aeag") -> CollectPolicy:
    return CollectPolicy(
        make_controller(leader, seed=0, networks={}),
        make_perturbation(name, seed=4),
        VirtualClock(),
    )


def test_the_follower_strays_from_what_the_leader_used() -> None:
    policy = collect("cycle")
    first = policy.reset(BOTH)
    assert isinstance(first.primary, Auto)
    assert first.secondary == first.primary.start
    assert policy.names == Pair("aeag", "perturb:cycle")
    decisions = policy.decide(frames(primary_us=2_000.0, secondary_us=29_000.0))
    assert decisions.primary.command == first.primary
    assert isinstance(decisions.secondary.command, Settings)
    assert 2_000 <= decisions.secondary.command.exposure_us <= 3_000
    assert decisions.secondary.diagnostics == {"quadrant": 0.0}


def test_without_perturbation_the_follower_copies_the_used_settings() -> None:
    policy = collect("none", "fixed:exposure_us=5000,gain_db=0")
    assert policy.reset(BOTH) == Pair(Settings(5_000.0, 0.0), Settings(5_000.0, 0.0))
    assert policy.decide(frames(primary_us=4_998.5)).secondary.command == Settings(4_998.5, 1.0)


def test_the_follower_keeps_to_its_own_limits() -> None:
    policy = collect("none", "fixed:exposure_us=5000,gain_db=0")
    narrow = Limits((75.0, 1_500.0), (0.0, 0.5))
    assert policy.reset(Pair(THESIS_LIMITS, narrow)).secondary == Settings(1_500.0, 0.0)
    assert policy.decide(frames()).secondary.command == Settings(1_500.0, 0.5)
