"""One recorded drive: what `race` and `collect` share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from rig.cli.exits import INTERRUPTED, LOSSES, OK
from rig.cli.interrupt import StopRequest, stop_on_signal
from rig.cli.options import is_simulated, make_folder
from rig.cli.provenance import command_line, git_commit, versions
from rig.cli.terminal import Advance, Terminal
from rig.cli.web import DEFAULT_WEB, WebOptions, watched
from rig.core.errors import RecordingError, RigError
from rig.core.protocols import PairPolicy, Source
from rig.core.types import Pair
from rig.experiments.replay import limit_options
from rig.loop import RunSummary, run_pair
from rig.pair import CameraPair
from rig.record.header import RunHeader
from rig.record.recover import repair_left_behind
from rig.record.writer import Expected, RecordWriter


@dataclass(frozen=True, slots=True)
class Drive:
    """A finished recording and how it ended; `run` counts what was recorded."""

    folder: Path
    run: RunSummary
    interrupted: bool

    @property
    def exit_code(self) -> int:
        """Return 130 after Ctrl-C, 3 with recorded losses, else 0."""
        if self.interrupted:
            return INTERRUPTED
        return OK if self.run.complete == self.run.triggers else LOSSES


def record_drive(
    source: Source,
    policy: PairPolicy,
    header: RunHeader,
    folder: Path,
    frames: int | None,
    terminal: Terminal,
    web: WebOptions = DEFAULT_WEB,
) -> Drive:
    """Drive `source` by `policy` for `frames` triggers, or to its end, into a new `folder`.

    What a controller refuses is raised before anything is written.
    """
    policy.reset(CameraPair(source).limits)
    make_folder(folder)
    try:
        return _record(source, policy, header, folder, frames, terminal, web)
    except RigError:
        with suppress(OSError):
            folder.rmdir()  # where nothing was written, the same --out can be named again
        raise


def _record(
    source: Source,
    policy: PairPolicy,
    header: RunHeader,
    folder: Path,
    frames: int | None,
    terminal: Terminal,
    web: WebOptions,
) -> Drive:
    triggers = frames if frames is not None else source.drive_triggers
    announce(source, triggers, terminal)
    repair_killed_runs(folder.parent, terminal)
    expected = Expected(triggers, source.rate_hz)
    with (
        stop_on_signal() as stop,
        RecordWriter(folder, header, real_time=source.real_time, expected=expected) as recorder,
        terminal.progress("driving", triggers) as advance,
        watched(recorder, web, terminal, source.address, folder, triggers) as watching,
    ):
        run = run_pair(source, policy, watching, until(triggers, stop, advance))
    recorded = replace(run, complete=run.complete - recorder.pairs_dropped)
    return Drive(folder, recorded, stop.requested)


def repair_killed_runs(runs: Path, terminal: Terminal) -> None:
    """Repair what an earlier run left unfinished among `runs`, and say so."""
    for path, found in repair_left_behind(runs):
        if isinstance(found, RecordingError):
            terminal.say(f"an earlier run was killed and cannot be repaired: {found}")
        else:
            terminal.say(f"repaired {path}, a run that was killed: {found.triggers} triggers kept")


def announce(source: Source, triggers: int | None, terminal: Terminal) -> None:
    """Say which cameras are driven, and whether they are real."""
    kind = "SIMULATED" if is_simulated(source.address) else "cameras"
    terminal.say(f"{kind}: {source.address}, {triggers or 'endless'} triggers")


def until(triggers: int | None, stop: StopRequest, advance: Advance) -> Callable[[int], bool]:
    """Return the loop's `keep_going`: to the last trigger, or to Ctrl-C."""

    def keep_going(done: int) -> bool:
        advance(done)
        return not stop.requested and (triggers is None or done < triggers)

    return keep_going


def make_header(
    source: Source,
    seed: int,
    controllers: Pair[str],
    options: Mapping[str, str],
    models: Mapping[str, str],
    calibration: str = "",
) -> RunHeader:
    """Return what the recording says about itself before its first frame."""
    primary, secondary = source.cameras
    limits = CameraPair(source).limits
    return RunHeader(
        command=command_line(),
        cameras=source.address,
        seed=seed,
        world_version=source.world_version,
        versions=versions(),
        git=git_commit(),
        serials=Pair(primary.serial, secondary.serial),
        intrinsics=source.intrinsics,
        controllers=controllers,
        options={**options, **limit_options(limits)},
        models=models,
        calibration=calibration,
    )
