"""The paired loop: apply, shoot, decide, record. Nothing else happens while driving.

    apply --> shoot --> decide --> record --.
      ^                                     |
      '-------------------------------------'

Settings reach the very next frame because nothing is in flight between `shoot` and `apply`: the
cameras wait for a trigger (thesis 5.1.1, next-frame mode). Collecting and racing differ only in
the policy that decides.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rig.core.protocols import PairPolicy, Recorder, Source
from rig.core.types import Command, Decision, Frame, Pair, PairRecord
from rig.pair import CameraPair, PairShot


@dataclass(frozen=True, slots=True)
class RunSummary:
    """What a run did, for the last line on the terminal."""

    triggers: int
    complete: int
    duration_s: float


def run_pair(
    source: Source,
    policy: PairPolicy,
    recorder: Recorder,
    keep_going: Callable[[int], bool],
) -> RunSummary:
    """Drive both cameras until `keep_going(triggers so far)` says no.

    On an incomplete pair no controller steps and the commands repeat.
    """
    pair = CameraPair(source)
    start_ns = source.clock.now_ns()
    asked = policy.reset(pair.limits)
    complete = 0
    while keep_going(pair.triggers):
        applied = pair.apply(asked)
        trigger = pair.triggers
        shot = pair.shoot()
        decisions = decide(policy, shot)
        recorder.write(make_record(source, trigger, asked, applied, shot, decisions))
        asked = next_commands(asked, decisions)
        complete += shot.cause == ""
    return RunSummary(pair.triggers, complete, (source.clock.now_ns() - start_ns) * 1e-9)


def decide(policy: PairPolicy, shot: PairShot) -> Pair[Decision | None]:
    """Let both controllers look at a complete pair; nobody decides on one that is not whole."""
    primary, secondary = shot.frames
    if shot.cause or not (isinstance(primary, Frame) and isinstance(secondary, Frame)):
        return Pair(None, None)
    return Pair(*policy.decide(Pair(primary, secondary)))


def next_commands(asked: Pair[Command], decisions: Pair[Decision | None]) -> Pair[Command]:
    """Return what both cameras are asked for next: the decisions, or the same again."""
    return Pair(
        *(
            command if decision is None else decision.command
            for command, decision in zip(asked, decisions, strict=True)
        )
    )


def make_record(
    source: Source,
    trigger: int,
    asked: Pair[Command],
    applied: Pair[Command],
    shot: PairShot,
    decisions: Pair[Decision | None],
) -> PairRecord:
    """Put together everything that one trigger left behind."""
    return PairRecord(
        trigger=trigger,
        pose_index=source.pose_index(trigger),
        asked=asked,
        applied=applied,
        shot=shot.frames,
        decisions=decisions,
        offset_ns=shot.offset_ns,
        cause=shot.cause,
        truth=source.truth(trigger),
    )
