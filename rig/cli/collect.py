"""`rig collect`: drives to learn from, one or many.

A leader exposes well and the other camera looks at the settings around it; or both stand still,
place by place, and sweep through all exposures.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import Literal

from cyclopts import Parameter

from rig.cli.attach import calibration_for
from rig.cli.drive import Drive, make_header, record_drive
from rig.cli.options import DEFAULT_RUN, RunOptions, Triggers, chosen_cameras, run_folder
from rig.cli.race import contestant, used_models
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.cli.web import DEFAULT_WEB, WebOptions
from rig.controllers.perturb import make_perturbation
from rig.controllers.policies import CollectPolicy, SweepPolicy, exposure_sweep
from rig.core.clock import SystemClock
from rig.core.errors import UsageError
from rig.core.types import Pair
from rig.drivers.registry import open_source
from rig.drivers.simulated.options import STAND


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class SweepOptions:
    """Whether to stand still and sweep, how finely, and where."""

    sweep: int | None = None
    """Take so many exposures at every place, standing still, instead of driving."""
    gains: float = 10.0
    """The gain in dB of all pictures of a sweep."""
    poses: Triggers = None
    """Places of a sweep; as many as the drive is long when absent."""
    step_m: float = 0.3
    """Metres from one place of a sweep to the next."""


NO_SWEEP = SweepOptions()


@dataclass(frozen=True, slots=True)
class Collection:
    """What is recorded on every drive: a led pair, or a sweep."""

    perturb: str
    leader: str
    sweep: SweepOptions


def collect(
    *,
    perturb: Literal["cycle", "intensity", "none"] = "cycle",
    leader: str = "aeag",
    sweep: SweepOptions = NO_SWEEP,
    seeds: str | None = None,
    workers: int | None = None,
    run: RunOptions = DEFAULT_RUN,
    web: WebOptions = DEFAULT_WEB,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Record a training drive, or many: a leader and perturbed settings, or a sweep.

    With --seeds the folder --out holds a recording for each world and manifest.json; after Ctrl-C
    the same command goes on.

    Parameters
    ----------
    perturb:
        How the secondary leaves the leader's settings: the four-quadrant cycle (thesis eq. 4.1),
        by the mean intensity (eq. 4.2), or not at all.
    leader:
        Controller of the primary camera.
    seeds:
        Collect in each of these worlds, such as 1-20 or 3,5,8.
    workers:
        How many drives to record at once with --seeds; one a core when absent.
    """
    if sweep.sweep is None and sweep != NO_SWEEP:
        raise UsageError("--gains, --poses and --step-m go with --sweep")
    wanted = Collection(perturb, leader, sweep)
    if seeds is not None:
        from rig.cli.collect_many import collect_many

        return collect_many(wanted, seeds, workers, run, terminal)
    if workers is not None:
        raise UsageError("--workers goes with --seeds: one drive is recorded by one process")
    drive = collect_drive(wanted, run, web, terminal)
    count = f"{drive.run.complete} of {drive.run.triggers} pairs complete"
    values = {"file": str(drive.folder), "pairs": drive.run.complete}
    terminal.result(f"{count}: {drive.folder}", values)
    return drive.exit_code


def collect_drive(
    wanted: Collection, run: RunOptions, web: WebOptions, terminal: Terminal
) -> Drive:
    """Record one drive into a new folder."""
    cameras = chosen_cameras(run.cameras)
    if wanted.sweep.sweep is not None:
        return _sweep(wanted.sweep, wanted.sweep.sweep, cameras, run, web, terminal)
    leading = contestant(wanted.leader, run.seed)
    with closing(open_source(cameras, seed=run.seed, split="train")) as source:
        folder = run_folder(run.out, "collect")
        perturbation = make_perturbation(wanted.perturb, seed=run.seed)
        policy = CollectPolicy(leading, perturbation, SystemClock())
        options = {f"primary.{key}": value for key, value in leading.options.items()}
        header = make_header(
            source,
            run.seed,
            Pair(*policy.names),
            options=options | {"perturb": wanted.perturb},
            models=used_models([leading]),
            calibration=calibration_for(source, run.calibration, terminal),
        )
        return record_drive(source, policy, header, folder, run.frames, terminal, web)


def _sweep(
    sweep: SweepOptions,
    exposures: int,
    cameras: str,
    run: RunOptions,
    web: WebOptions,
    terminal: Terminal,
) -> Drive:
    policy = SweepPolicy(exposure_sweep(exposures, sweep.gains))
    if run.frames is not None:
        raise UsageError("--frames does not go with --sweep: say how many places with --poses")
    if not cameras.startswith("sim:"):
        raise UsageError(
            f"{cameras}: only simulated cameras stand still by themselves, place by "
            "place; take a real sweep with one run a place"
        )
    triggers_a_place = exposures // 2
    standing = (
        f"{cameras}{'&' if '?' in cameras else '?'}{STAND}={triggers_a_place}@{sweep.step_m:g}"
    )
    with closing(open_source(standing, seed=run.seed, split="train")) as source:
        folder = run_folder(run.out, "collect")
        options = {
            "sweep": str(exposures),
            "gains": f"{sweep.gains:g}",
            "step_m": f"{sweep.step_m:g}",
        }
        header = make_header(source, run.seed, policy.names, options=options, models={})
        frames = None if sweep.poses is None else sweep.poses * triggers_a_place
        return record_drive(source, policy, header, folder, frames, terminal, web)
