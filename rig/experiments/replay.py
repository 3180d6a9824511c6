"""The same controller over the frames of a recording: does it decide the same again?"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from rig.controllers.policies import RacePolicy
from rig.controllers.registry import NamedController
from rig.core.clock import SystemClock
from rig.core.types import (
    SIDES,
    THESIS_LIMITS,
    Auto,
    Command,
    Decision,
    Diagnostics,
    Frame,
    Limits,
    Pair,
    PairRecord,
    Settings,
    Side,
)

_MAX_MISMATCHES = 100


@dataclass(frozen=True, slots=True)
class Mismatch:
    """A decision that came out differently; commands and thoughts as plain words."""

    trigger: int
    side: Side
    recorded: Mapping[str, Any]
    replayed: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Replay:
    """What a controller said to a recording.

    `compared` decisions stand beside recorded ones of the same controller; of those that differ
    in any bit `different` is the count, `mismatches` holds the first 100. `commands` are those
    for each camera, by trigger.
    """

    compared: int
    different: int
    mismatches: list[Mismatch]
    commands: Pair[dict[int, Command]]


def recorded_limits(options: Mapping[str, str]) -> Pair[Limits]:
    """Return the limits that the controllers were given; the thesis' where none are recorded."""
    return Pair(*(_limits(options, side) for side in SIDES))


def limit_options(limits: Pair[Limits]) -> dict[str, str]:
    """Return limits as options of a recording, from which `recorded_limits` reads them."""
    return {
        f"{side}.limits.{name}": f"{low!r}..{high!r}"
        for side, each in zip(SIDES, limits, strict=True)
        for name, (low, high) in (("exposure_us", each.exposure_us), ("gain_db", each.gain_db))
    }


def replay(
    records: Iterable[PairRecord],
    wired: Pair[NamedController],
    limits: Pair[Limits],
    sides: tuple[Side, ...],
    progress: Callable[[int], None],
) -> Replay:
    """Let both controllers look at every complete pair; compare those on `sides`."""
    policy = RacePolicy(wired.primary, wired.secondary, SystemClock())
    policy.reset(limits)
    compared = different = 0
    mismatches: list[Mismatch] = []
    commands: Pair[dict[int, Command]] = Pair({}, {})
    for done, record in enumerate(records, start=1):
        progress(done)
        primary, secondary = record.shot
        if not (record.complete and isinstance(primary, Frame) and isinstance(secondary, Frame)):
            continue
        decided = policy.decide(Pair(primary, secondary))
        for side, told, now in zip(SIDES, record.decisions, decided, strict=True):
            getattr(commands, side)[record.trigger] = now.command
            if side not in sides or told is None:
                continue
            compared += 1
            before, again = _words(told), _words(now)
            if before != again:
                different += 1
                mismatches.append(Mismatch(record.trigger, side, before, again))
    return Replay(compared, different, mismatches[:_MAX_MISMATCHES], commands)


def command_words(command: Command) -> dict[str, Any]:
    """Return a command as plain numbers."""
    if isinstance(command, Settings):
        return {"exposure_us": command.exposure_us, "gain_db": command.gain_db}
    return {"auto": _auto_words(command)}


def _auto_words(auto: Auto) -> dict[str, Any]:
    return {
        "exposure_us": list(auto.limits.exposure_us),
        "gain_db": list(auto.limits.gain_db),
        "target_dn": auto.target_dn,
        "damping": auto.damping,
        "metering": auto.metering,
        "priority": auto.priority,
        "start": command_words(auto.start),
    }


def _words(decision: Decision) -> dict[str, Any]:
    return {**command_words(decision.command), "thoughts": _thoughts(decision.diagnostics)}


def _thoughts(diagnostics: Diagnostics) -> dict[str, str]:
    """Return numbers to the last bit, as text in which NaN equals NaN."""
    return {
        key: value if isinstance(value, str) else repr(float(value))
        for key, value in diagnostics.items()
    }


def _limits(options: Mapping[str, str], side: Side) -> Limits:
    try:
        exposure_us, gain_db = (
            tuple(map(float, options[f"{side}.limits.{name}"].split("..")))
            for name in ("exposure_us", "gain_db")
        )
        return Limits((exposure_us[0], exposure_us[1]), (gain_db[0], gain_db[1]))
    except (KeyError, ValueError, IndexError):
        return THESIS_LIMITS
