"""`rig race LEFT RIGHT`: one controller on each camera, the same instant, one verdict."""

from __future__ import annotations

from contextlib import closing
from typing import Annotated

from cyclopts import Parameter

from rig.cli.drive import make_header, record_drive
from rig.cli.judge import publish
from rig.cli.options import DEFAULT_RUN, RunOptions, make_run_folder
from rig.cli.provenance import file_sha256
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.controllers.policies import RacePolicy
from rig.controllers.registry import NamedController, make_controller
from rig.core.clock import SystemClock
from rig.core.types import Pair
from rig.drivers.registry import open_source
from rig.models.shipped import shipped_networks


def race(
    left: str,
    right: str,
    /,
    *,
    swap: Annotated[bool, Parameter(negative="")] = False,
    run: RunOptions = DEFAULT_RUN,
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
    """
    left_right = Pair(contestant(left, run.seed), contestant(right, run.seed))
    wired = Pair(left_right.secondary, left_right.primary) if swap else left_right
    with closing(open_source(run.cameras, seed=run.seed, split="test")) as source:
        folder = make_run_folder(run.out, "race")
        header = make_header(
            source,
            run.seed,
            Pair(wired.primary.name, wired.secondary.name),
            options=race_options(wired, swap),
            models=used_models(wired),
        )
        policy = RacePolicy(wired.primary, wired.secondary, SystemClock())
        drive = record_drive(source, policy, header, folder, run.frames, terminal)
    publish(folder, terminal)
    return drive.exit_code


def contestant(spec: str, seed: int) -> NamedController:
    """Return the controller that `spec` names, shipped networks included."""
    return make_controller(spec, seed=seed, networks=shipped_networks())


def race_options(wired: Pair[NamedController], swap: bool) -> dict[str, str]:
    """Return every resolved option, as it goes into the recording."""
    options = {"swap": str(swap).lower()}
    for side, controller in zip(Pair._fields, wired, strict=True):
        options |= {f"{side}.{key}": value for key, value in controller.options.items()}
    return options


def used_models(wired: Pair[NamedController]) -> dict[str, str]:
    """Return the hash of each network file that takes part."""
    paths = {item.name: item.model for item in wired if item.model is not None}
    return {name: file_sha256(path) for name, path in paths.items()}
