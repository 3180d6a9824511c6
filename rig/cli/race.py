"""`rig race LEFT RIGHT`: one controller on each camera, the same instant, one verdict."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from rig.cli.attach import calibration_for
from rig.cli.drive import make_header, record_drive
from rig.cli.evaluate import publish_league, together, words
from rig.cli.exits import INTERRUPTED
from rig.cli.judge import REPORT, publish, tell
from rig.cli.options import DEFAULT_RUN, RunOptions, chosen_cameras, names_a_world, run_folder
from rig.cli.provenance import file_sha256
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.cli.web import DEFAULT_WEB, WebOptions
from rig.controllers.policies import RacePolicy
from rig.controllers.registry import NamedController, make_controller
from rig.core.clock import SystemClock
from rig.core.errors import UsageError
from rig.core.types import Pair
from rig.drivers.registry import open_source
from rig.evaluation.summary import Summary
from rig.models.shipped import shipped_networks


def race(
    left: str,
    right: str,
    /,
    *,
    swap: Annotated[bool, Parameter(negative="")] = False,
    seeds: str | None = None,
    run: RunOptions = DEFAULT_RUN,
    web: WebOptions = DEFAULT_WEB,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Drive each camera by its own controller, record, judge, and report.

    Parameters
    ----------
    left:
        Controller of the primary camera: ours, shin, aeag, fixed:exposure_us=700,gain_db=0, ...
    right:
        Controller of the secondary camera; the same as LEFT for the control experiment.
    swap:
        Give LEFT the secondary camera instead.
    seeds:
        Race on each of these seeds, such as 1-20 or 3,5,8, and compare over all of them.
    """
    wiring = (right, left) if swap else (left, right)
    folder = run_folder(run.out, "race")
    if seeds is not None:
        if names_a_world(run.cameras):
            terminal.say(f"{run.cameras} is one world: over --seeds only noise differs")
        return race_seeds(wiring, swap, parse_seeds(seeds), run, folder, terminal, web)
    raced = race_once(wiring, swap, run, folder, terminal, web)
    tell(folder, raced.summary, terminal)
    return raced.exit_code


def race_seeds(
    wiring: tuple[str, str],
    swap: bool,
    seeds: list[int],
    run: RunOptions,
    folder: Path,
    terminal: Terminal,
    web: WebOptions,
) -> int:
    """Race once a seed, each into its own folder, and write what they come to together."""
    summaries, codes = [], []
    for seed in seeds:
        terminal.say(f"seed {seed}:")
        raced = race_once(wiring, swap, replace(run, seed=seed), folder / f"{seed}", terminal, web)
        summaries.append(raced.summary)
        codes.append(raced.exit_code)
        if raced.exit_code == INTERRUPTED:
            break
    values = together(summaries)
    publish_league(folder, values)
    text = f"{words(values)}\nreports: {folder}/*/{REPORT}\nreport of all: {folder / REPORT}"
    terminal.result(text, values)
    return max(codes)


def race_once(
    wiring: tuple[str, str],
    swap: bool,
    run: RunOptions,
    folder: Path,
    terminal: Terminal,
    web: WebOptions,
) -> Raced:
    """Drive once and publish the run in `folder`; `wiring` is (primary, secondary)."""
    primary, secondary = (contestant(spec, run.seed) for spec in wiring)
    wired = Pair(primary, secondary)
    with closing(open_source(chosen_cameras(run.cameras), seed=run.seed, split="test")) as source:
        header = make_header(
            source,
            run.seed,
            Pair(primary.name, secondary.name),
            options=race_options(wired, swap),
            models=used_models(wired),
            calibration=calibration_for(source, run.calibration, terminal),
        )
        policy = RacePolicy(primary, secondary, SystemClock())
        drive = record_drive(source, policy, header, folder, run.frames, terminal, web)
    return Raced(publish(folder, terminal), drive.exit_code)


@dataclass(frozen=True, slots=True)
class Raced:
    """One race, judged, and how it ended."""

    summary: Summary
    exit_code: int


def parse_seeds(text: str) -> list[int]:
    """Return the seeds that `1-20` or `3,5,8` names; raises UsageError for anything else."""
    seeds: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        try:
            seeds += range(int(first), int(last or first) + 1)
        except ValueError:
            raise UsageError(f"--seeds {text!r}: write 1-20 or 3,5,8") from None
    if not seeds:
        raise UsageError(f"--seeds {text!r} names no seed: write 1-20 or 3,5,8")
    return seeds


def contestant(spec: str, seed: int) -> NamedController:
    """Return the controller that `spec` names, shipped networks included."""
    return make_controller(spec, seed=seed, networks=shipped_networks())


def race_options(wired: Pair[NamedController], swap: bool) -> dict[str, str]:
    """Return every resolved option, as it goes into the recording."""
    options = {"swap": str(swap).lower()}
    for side, controller in zip(Pair._fields, wired, strict=True):
        options |= {f"{side}.{key}": value for key, value in controller.options.items()}
    return options


def used_models(driving: Sequence[NamedController]) -> dict[str, str]:
    """Return the hash of each network file that takes part."""
    paths = {item.name: item.model for item in driving if item.model is not None}
    return {name: file_sha256(path) for name, path in paths.items()}
