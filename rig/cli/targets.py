"""`rig targets REC...`: what the network should have asked for, pose by pose."""

from __future__ import annotations

from pathlib import Path

from rig.cli.exits import OK
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal


def targets(
    *recordings: Path,
    out: Path,
    metric: str = "hybrid",
    window: int = 4,
    alpha: float = 0.5,
    workers: int | None = None,
    dask: str = "",
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Find the settings to aim for at every pose of recordings (thesis eq. 4.11 to 4.13).

    Parameters
    ----------
    recordings:
        Folders or files that `rig collect` wrote.
    out:
        The target file to write.
    metric:
        feat, grid, or hybrid of both.
    window:
        How many poses ahead the best picture may lie.
    alpha:
        Weight of feat in hybrid, 0 to 1.
    workers:
        How many recordings to work on at once; one a core when absent.
    dask:
        Address of a Dask scheduler whose workers do it instead, such as tcp://10.0.0.5:8786.
    """
    from rig.bulk import ALONE, Workers
    from rig.models.targets import make_targets, refuse_existing

    refuse_existing(out)
    with terminal.progress("targets", None) as advance:
        found = make_targets(
            recordings,
            metric,
            window,
            alpha,
            lambda _, done, total: advance(done, total),
            Workers(workers, dask) if len(recordings) > 1 or dask else ALONE,
        )
    found.save(out)
    count = len(found.poses)
    terminal.result(
        f"{count} poses of {len(found.recordings)} recordings: {out}",
        {"file": str(out), "poses": count, "recordings": len(found.recordings)},
    )
    return OK
