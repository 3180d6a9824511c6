"""`rig collect`: a leader exposes well, the other camera looks at the settings around it."""

from __future__ import annotations

from contextlib import closing
from typing import Literal

from rig.cli.attach import calibration_for
from rig.cli.drive import make_header, record_drive
from rig.cli.options import DEFAULT_RUN, RunOptions, chosen_cameras, make_folder, run_folder
from rig.cli.race import contestant
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.cli.web import DEFAULT_WEB, WebOptions
from rig.controllers.perturb import make_perturbation
from rig.controllers.policies import CollectPolicy
from rig.core.clock import SystemClock
from rig.core.types import Pair
from rig.drivers.registry import open_source


def collect(
    *,
    perturb: Literal["cycle", "intensity", "none"] = "cycle",
    leader: str = "aeag",
    run: RunOptions = DEFAULT_RUN,
    web: WebOptions = DEFAULT_WEB,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Record a training drive: a leader on the primary, perturbed settings on the secondary.

    Parameters
    ----------
    perturb:
        How the secondary leaves the leader's settings: the four-quadrant cycle (thesis eq. 4.1),
        by the mean intensity (eq. 4.2), or not at all.
    leader:
        Controller of the primary camera.
    """
    leading = contestant(leader, run.seed)
    with closing(open_source(chosen_cameras(run.cameras), seed=run.seed, split="train")) as source:
        folder = run_folder(run.out, "collect")
        policy = CollectPolicy(leading, make_perturbation(perturb, seed=run.seed), SystemClock())
        options = {f"primary.{key}": value for key, value in leading.options.items()}
        header = make_header(
            source,
            run.seed,
            Pair(*policy.names),
            options=options | {"perturb": perturb},
            models={},
            calibration=calibration_for(source, run.calibration, terminal),
        )
        make_folder(folder)
        drive = record_drive(source, policy, header, folder, run.frames, terminal, web)
    count = f"{drive.run.complete} of {drive.run.triggers} pairs complete"
    terminal.result(f"{count}: {folder}", {"file": str(folder), "pairs": drive.run.complete})
    return drive.exit_code
