"""The experiments as pair policies: a race, a leader with a perturbed follower, a sweep."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from rig.controllers.perturb import Perturbation
from rig.controllers.registry import NamedController
from rig.core.errors import UsageError
from rig.core.protocols import Clock
from rig.core.types import (
    THESIS_LIMITS,
    Auto,
    Command,
    Decision,
    Diagnostics,
    Frame,
    Limits,
    Pair,
    Settings,
)

log = logging.getLogger(__name__)

MS_PER_NS = 1e-6


@dataclass(slots=True)
class _Seat:
    """Asks for one side's decisions, times them, and holds the last command on a failure."""

    name: str
    stopwatch: Clock
    command: Command
    failed: bool = False

    def ask(
        self,
        step: Callable[[Frame], Command],
        diagnostics: Callable[[], Diagnostics],
        frame: Frame,
    ) -> Decision:
        start_ns = self.stopwatch.now_ns()
        try:
            command, thoughts = step(frame), dict(diagnostics())
            if not isinstance(command, Settings | Auto):
                raise TypeError(f"returned {command!r}, which is no command")
        except Exception as problem:  # a driver must not miss a trigger for a controller's bug
            command, thoughts = self.command, {"held": f"{type(problem).__name__}: {problem}"}
            if not self.failed:
                log.warning("%s holds its last command: %s", self.name, thoughts["held"])
            self.failed = True
        latency_ms = (self.stopwatch.now_ns() - start_ns) * MS_PER_NS
        self.command = command
        return Decision(self.name, command, latency_ms, thoughts)


@dataclass(slots=True)
class RacePolicy:
    """Each camera follows its own controller; LEFT drives the primary (thesis 5.1).

    `stopwatch` measures how long each decision takes.
    """

    left: NamedController
    right: NamedController
    stopwatch: Clock
    _seats: Pair[_Seat] = field(init=False)

    @property
    def names(self) -> Pair[str]:
        """Return the names of both controllers."""
        return Pair(self.left.name, self.right.name)

    def reset(self, limits: Pair[Limits]) -> Pair[Command]:
        """Start both; raises ControllerError when one cannot drive its camera."""
        commands: Pair[Command] = Pair(
            self.left.controller.reset(limits.primary),
            self.right.controller.reset(limits.secondary),
        )
        self._seats = Pair(
            _Seat(self.left.name, self.stopwatch, commands.primary),
            _Seat(self.right.name, self.stopwatch, commands.secondary),
        )
        return commands

    def decide(self, frames: Pair[Frame]) -> Pair[Decision]:
        """Let each controller look at its own camera's frame."""
        left, right = self.left.controller, self.right.controller
        return Pair(
            self._seats.primary.ask(left.step, left.diagnostics, frames.primary),
            self._seats.secondary.ask(right.step, right.diagnostics, frames.secondary),
        )


@dataclass(slots=True)
class CollectPolicy:
    """The primary follows the leader; the secondary strays from what the primary used (4.2.2).

    `stopwatch` measures how long each decision takes.
    """

    leader: NamedController
    perturbation: Perturbation
    stopwatch: Clock
    _seats: Pair[_Seat] = field(init=False)

    @property
    def names(self) -> Pair[str]:
        """Return the leader's name and the perturbation's."""
        return Pair(self.leader.name, f"perturb:{self.perturbation.name}")

    def reset(self, limits: Pair[Limits]) -> Pair[Command]:
        """Start the leader, and the secondary where the leader starts."""
        lead = self.leader.controller.reset(limits.primary)
        self.perturbation.reset(limits.secondary)
        start = lead.start if isinstance(lead, Auto) else lead
        commands: Pair[Command] = Pair(lead, start.clamp(limits.secondary))
        self._seats = Pair(
            _Seat(self.names.primary, self.stopwatch, commands.primary),
            _Seat(self.names.secondary, self.stopwatch, commands.secondary),
        )
        return commands

    def decide(self, frames: Pair[Frame]) -> Pair[Decision]:
        """Let the leader look at its frame, and stray from the settings of that frame."""
        leader, perturbation = self.leader.controller, self.perturbation
        return Pair(
            self._seats.primary.ask(leader.step, leader.diagnostics, frames.primary),
            self._seats.secondary.ask(perturbation.near, perturbation.diagnostics, frames.primary),
        )


@dataclass(slots=True)
class SweepPolicy:
    """Both cameras take their turns through one list of settings, at every place again.

    The primary takes the first, third, ... of `settings`, the secondary the second, fourth, ...
    """

    settings: Sequence[Settings]
    _taken: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        if len(self.settings) < 2 or len(self.settings) % 2:
            raise UsageError(f"--sweep must be an even number from 2, got {len(self.settings)}")

    @property
    def names(self) -> Pair[str]:
        """Return the same name for both."""
        return Pair("sweep", "sweep")

    def reset(self, limits: Pair[Limits]) -> Pair[Command]:
        """Return the first two settings; raises UsageError for some that a camera cannot take."""
        for settings, allowed in zip(self.settings, limits * len(self.settings), strict=False):
            if settings.clamp(allowed) != settings:
                raise UsageError(
                    f"a sweep of {settings.exposure_us:g} us at {settings.gain_db:g} dB is outside "
                    f"the camera's {allowed}"
                )
        self._taken = 0
        return self._next()

    def decide(self, frames: Pair[Frame]) -> Pair[Decision]:
        """Return the next two settings, whatever the frames show."""
        return Pair(
            *(
                Decision(name, command, 0.0)
                for name, command in zip(self.names, self._next(), strict=True)
            )
        )

    def _next(self) -> Pair[Command]:
        at = 2 * self._taken % len(self.settings)
        self._taken += 1
        return Pair(self.settings[at], self.settings[at + 1])


def exposure_sweep(count: int, gain_db: float, limits: Limits = THESIS_LIMITS) -> list[Settings]:
    """Return `count` exposures in equal ratios over the limits, all at one gain (thesis 4.2.2)."""
    low_us, high_us = limits.exposure_us
    ratios = [index / max(count - 1, 1) for index in range(count)]
    return [
        Settings(min(low_us * (high_us / low_us) ** ratio, high_us), gain_db) for ratio in ratios
    ]
