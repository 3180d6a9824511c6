"""`rig bound CAMERAS`: how well the best controller could do on a drive, knowing the future."""

from __future__ import annotations

from dataclasses import asdict

from rig.cli.exits import OK
from rig.cli.options import DEFAULT_CAMERAS, Triggers
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal


def bound(
    cameras: str = DEFAULT_CAMERAS,
    /,
    *,
    frames: Triggers = None,
    seed: int = 0,
    exposures: int = 10,
    gains: int = 5,
    processes: int | None = None,
    dask: str = "",
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Work out the best median and minimum of inliers that a grid of settings allows.

    The paths that reach them know the future and the noise; what they have in other noise is told
    as well. Settings between those of the grid can do better where small steps count. Counts are
    kept in the user's cache: after Ctrl-C the same command goes on.

    Parameters
    ----------
    cameras:
        Address of a simulated pair, such as sim:tunnel?seed=3.
    frames:
        The first so many triggers; the whole drive when absent.
    seed:
        Picks the world unless the address does.
    exposures:
        Exposure times to try at every pose, at least 10.
    gains:
        Gains to try with each of them, at least 4.
    processes:
        How many to work in; one a core when absent.
    dask:
        Address of a Dask scheduler whose workers do it instead, such as tcp://10.0.0.5:8786.
    """
    from rig.experiments.bound import find_bound

    with terminal.progress("trying settings", None) as advance:
        found = find_bound(
            cameras,
            seed=seed,
            frames=frames,
            grid=(exposures, gains),
            processes=processes,
            dask=dask,
            progress=advance,
        )
    best, steadiest = found.best_constant, found.steadiest_constant
    terminal.result(
        f"SIMULATED: {found.cameras}\n"
        f"best median {found.best_median}, best minimum {found.best_min}: each by a path of its "
        f"own over {exposures} x {gains} settings\n"
        f"in other noise the same paths have a median of {found.replayed.median:.0f} and a minimum "
        f"of {found.replayed.min:.0f}\n"
        f"best constant {best.settings.exposure_us:.0f} us, {best.settings.gain_db:g} dB: "
        f"median {best.median:.0f}, minimum {best.min}\n"
        f"steadiest constant {steadiest.settings.exposure_us:.0f} us, "
        f"{steadiest.settings.gain_db:g} dB: median {steadiest.median:.0f}, "
        f"minimum {steadiest.min}",
        asdict(found),
    )
    return OK
