"""`rig targets REC...`: what the network should have asked for, pose by pose."""

from __future__ import annotations

from pathlib import Path

from rig.cli.evaluate import unfolded
from rig.cli.exits import OK
from rig.cli.options import Triggers, refuse_own_seed
from rig.cli.race import parse_seeds
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.errors import UsageError

PATH = "path"


def targets(
    *recordings: str,
    out: Path,
    metric: str = "hybrid",
    window: int = 4,
    alpha: float = 0.5,
    seeds: str | None = None,
    first: int = 0,
    frames: Triggers = None,
    processes: int | None = None,
    workers: int | None = None,
    dask: str = "",
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Find the settings to aim for at every pose of recordings (thesis eq. 4.11 to 4.13).

    Parameters
    ----------
    recordings:
        Folders or files that `rig collect` wrote; for path, simulated cameras as well.
    out:
        The target file to write.
    metric:
        feat, uni, grid, seq, hybrid (of feat and grid), pose, or path: the best path over all
        settings of a drive.
    window:
        How many poses ahead the best picture may lie; 1 for sweeps.
    alpha:
        Weight of feat in hybrid, 0 to 1.
    seeds:
        The worlds of simulated cameras, such as 1-12; with path only.
    first:
        The pose that each simulated drive begins with; with path only.
    frames:
        Poses of each simulated drive, all that are left when absent; with path only.
    processes:
        How many to work in, one a core when absent; with path only.
    workers:
        How many recordings to work on at once; one a core when absent.
    dask:
        Address of a Dask scheduler whose workers do it instead, such as tcp://10.0.0.5:8786.
    """
    from rig.bulk import ALONE, Workers
    from rig.models.targets import make_targets, require_new

    require_new(out)
    simulated = [name for name in recordings if name.startswith("sim:")]
    if simulated and (metric != PATH or len(simulated) < len(recordings)):
        raise UsageError(
            f"{simulated[0]}: simulated cameras go with --metric path, and not with recordings"
        )
    if simulated:
        return _paths(_worlds(simulated, seeds), out, first, frames, processes, terminal)
    if seeds is not None or first or frames is not None or processes is not None:
        raise UsageError(
            "--seeds, --first, --frames and --processes go with simulated cameras only"
        )
    runs = [run for name in recordings for run in unfolded(Path(name))]
    with terminal.progress("targets", None) as advance:
        found = make_targets(
            runs,
            metric,
            window,
            alpha,
            lambda _, done, total: advance(done, total),
            Workers(workers, dask) if len(runs) > 1 or dask else ALONE,
            folder=out.parent,
        )
    found.save(out)
    count = len(found.poses)
    terminal.result(
        f"{count} poses of {len(found.recordings)} recordings: {out}",
        {"file": str(out), "poses": count, "recordings": len(found.recordings)},
    )
    return OK


def _paths(
    cameras: list[str],
    out: Path,
    first: int,
    frames: int | None,
    processes: int | None,
    terminal: Terminal,
) -> int:
    from rig.models.scoremap.paths import make_paths

    with terminal.progress("trying settings", None) as advance:
        found = make_paths(
            cameras, first=first, frames=frames, processes=processes, progress=advance
        )
    found.save(out)
    count = sum(len(drive.thumbnails) for drive in found.drives)
    terminal.result(
        f"{count} poses of {len(cameras)} drives, {len(found.grid)} settings each: {out}",
        {"file": str(out), "poses": count, "recordings": len(cameras)},
    )
    return OK


def _worlds(cameras: list[str], seeds: str | None) -> list[str]:
    """Return one address a world: every address with every seed."""
    if seeds is None:
        return cameras
    for address in cameras:
        refuse_own_seed(address)
    return [
        f"{address}{'&' if '?' in address else '?'}seed={seed}"
        for address in cameras
        for seed in parse_seeds(seeds)
    ]
