"""Several methods on the same drives of the test split, and the ratios between them.

Each drives alone on the primary camera, which is what it would see in a race. Drives that are
done are kept, so that an experiment that was cut short goes on.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.bulk import Workers, run_tasks
from rig.controllers.registry import make_controller
from rig.drivers.registry import open_source
from rig.evaluation.aggregate import ratio_ci95, ratio_of_means
from rig.evaluation.odometry import mean_inlier_pct, processed_pct
from rig.experiments.reproduce import Job
from rig.experiments.solo import Solo, run_solo, world_version
from rig.models.scoremap.seen import MOVES_M
from rig.models.shipped import shipped_networks
from rig.plot import Bars, svg

FIGURES: Mapping[str, str] = {
    "orb_median": "ORB median",
    "viso2_median": "viso2 median",
    "orb_min": "ORB minimum",
    "viso2_min": "viso2 minimum",
    "processed_pct": "frames processed, %",
    "inlier_pct": "mean inliers, %",
    "lost_moving_pct": "lost while moving, %",
}
"""What is told of each drive.

`processed_pct` and `inlier_pct` are those of thesis table 5.5. `lost_moving_pct` leaves waits out:
the share of frames without a motion told, of those before which the camera moved by MOVES_M.
"""

Figures = Mapping[str, float | None]


@dataclass(frozen=True, slots=True)
class Duel:
    """A network and a rival; `published` maps figures to what the thesis has: (rival, network)."""

    network: str
    rival: str
    published: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Contest:
    """One table: `methods` maps the thesis' names to controllers, `figures` are its columns.

    `seeds` are those of the test worlds. `compared` says between whom ratios are told.
    """

    world: str
    seeds: Sequence[int]
    figures: Sequence[str]
    methods: Mapping[str, str]
    compared: Sequence[Duel]


@dataclass(frozen=True, slots=True)
class Drive:
    """One drive of a contest."""

    address: str
    seed: int
    frames: int | None
    controllers: Sequence[str]


def hold(contest: Contest, job: Job) -> dict[str, Any]:
    """Drive what was not driven yet and return the table as it is in JSON.

    One drive of 40 pairs of 320x240 when quick. A finished drive is kept in the job's folder under
    a name that changes with the world, the networks and the controllers.
    """
    drives = _drives(contest, job.quick)
    version = world_version(drives[0].address)
    files = {drive.address: job.folder / f"{_name(drive, version)}.json" for drive in drives}
    left = {drive.address: drive for drive in drives if not files[drive.address].exists()}
    done = len(drives) - len(left)
    job.say(
        f"SIMULATED: {len(contest.methods)} methods on {_counted(drives)} of {version}, "
        f"test split; {done} of them driven before"
    )
    for address, figures in run_tasks(_driven, left, Workers(job.processes)):
        _keep(files[address], figures)
        done += 1
        job.advance(done, len(drives))
    found = [json.loads(files[drive.address].read_text(encoding="utf-8")) for drive in drives]
    return table(contest, drives, version, found)


def words(values: Mapping[str, Any]) -> str:
    """Return the methods' figures, and the ratios here beside the thesis', as Markdown."""
    names = values["figures"]
    titles = " | ".join(FIGURES[name] for name in names)
    rule = "|---" * len(names) + "|"
    lines = [
        f"SIMULATED: {values['world_version']}, {_counted(values['drives'])} of the test split; "
        "means over the drives",
        "",
        f"| method | {titles} |",
        f"|---{rule}",
    ]
    for method, row in values["methods"].items():
        cells = " | ".join(_number(row["mean"][name]) for name in names)
        lines.append(f"| {method} (`{row['controller']}`) | {cells} |")
    lines += ["", f"| network over rival, 95 %; in the thesis | {titles} |", f"|---{rule}"]
    for duel in values["duels"]:
        cells = " | ".join(_compared(duel, name) for name in names)
        lines.append(f"| {duel['network']} over {duel['rival']} | {cells} |")
    return "\n".join(lines)


def draw(values: Mapping[str, Any]) -> str:
    """Return the figures as bars, a panel each, with a dot a drive."""
    panels = [
        Bars(
            FIGURES[name],
            {method: _of_drives(row, name) for method, row in values["methods"].items()},
        )
        for name in values["figures"]
    ]
    return svg(panels)


def _of_drives(row: Mapping[str, Any], name: str) -> list[float]:
    return [drive[name] for drive in row["by_drive"] if drive[name] is not None]


def _drives(contest: Contest, quick: bool) -> list[Drive]:
    size, frames = ("320x240", 40) if quick else ("640x480", None)
    seeds = contest.seeds[:1] if quick else contest.seeds
    controllers = list(contest.methods.values())
    return [
        Drive(f"sim:{contest.world}?split=test&seed={seed}&size={size}", seed, frames, controllers)
        for seed in seeds
    ]


def _driven(drive: Drive) -> dict[str, Figures]:
    """Return each controller's figures on one drive, by its specification."""
    named = [make_controller(c, seed=0, networks=shipped_networks()) for c in drive.controllers]
    solos = run_solo(drive.address, named, seed=drive.seed, frames=drive.frames)
    way_m = _way_m(drive)
    return {c: figures_of(solo, way_m) for c, solo in zip(drive.controllers, solos, strict=True)}


def _way_m(drive: Drive) -> NDArray[np.float64]:
    """Return how far the camera moved since the frame before, at every trigger."""
    with closing(open_source(drive.address, seed=drive.seed)) as source:
        truths = (source.truth(k) for k in range(drive.frames or source.drive_triggers or 0))
        places_m = np.array([truth.position_m for truth in truths if truth is not None])
    moves_m = np.diff(places_m, axis=0, prepend=places_m[:1])
    return np.asarray(np.linalg.norm(moves_m, axis=1), np.float64)


def _keep(path: Path, figures: Mapping[str, Figures]) -> None:
    unfinished = path.with_suffix(".part")
    unfinished.write_text(json.dumps(figures), encoding="utf-8")
    unfinished.replace(path)


def figures_of(solo: Solo, way_m: NDArray[np.float64]) -> Figures:
    """Return what is told of a drive; `way_m` has the move before each trigger."""
    counts = {
        f"{name}_{key}": getattr(statistics, key)
        for name, statistics in solo.inliers.items()
        for key in ("median", "min")
    }
    moving = processed_pct([step for step in solo.steps if way_m[step.trigger] >= MOVES_M])
    return counts | {
        "processed_pct": processed_pct(solo.steps),
        "inlier_pct": mean_inlier_pct(solo.steps),
        "lost_moving_pct": None if moving is None else 100.0 - moving,
    }


def table(
    contest: Contest,
    drives: Sequence[Drive],
    version: str,
    found: Sequence[Mapping[str, Figures]],
) -> dict[str, Any]:
    """Return the table of drives, each with the figures of every controller, as it is in JSON."""
    rows = {
        method: [drive[controller] for drive in found]
        for method, controller in contest.methods.items()
    }
    return {
        "schema": "rig.contest/1",
        "world_version": version,
        "split": "test",
        "drives": [drive.address for drive in drives],
        "figures": list(contest.figures),
        "methods": {
            method: {
                "controller": contest.methods[method],
                "mean": {name: _mean([row[name] for row in driven]) for name in FIGURES},
                "by_drive": driven,
            }
            for method, driven in rows.items()
        },
        "duels": [_duel(duel, rows, contest.figures) for duel in contest.compared],
    }


def _duel(
    duel: Duel, rows: Mapping[str, Sequence[Figures]], figures: Sequence[str]
) -> dict[str, Any]:
    return {
        "network": duel.network,
        "rival": duel.rival,
        "ratios": {
            name: _ratio(
                [row[name] for row in rows[duel.network]], [r[name] for r in rows[duel.rival]]
            )
            for name in figures
        },
        "published": {name: list(pair) for name, pair in duel.published.items()},
    }


def _ratio(network: Sequence[float | None], rival: Sequence[float | None]) -> dict[str, Any]:
    pairs = [pair for pair in zip(network, rival, strict=True) if None not in pair]
    values = np.array(pairs, np.float64).reshape(-1, 2)
    return {"ratio": ratio_of_means(values), "ci95": ratio_ci95(values, seed=0)}


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return fmean(known) if known else None


def _counted(drives: Sequence[object]) -> str:
    return f"{len(drives)} drive{'' if len(drives) == 1 else 's'}"


def _number(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def _compared(duel: Mapping[str, Any], name: str) -> str:
    here = duel["ratios"][name]
    if here["ratio"] is None:
        text = "rival has 0"
    else:
        text = f"{here['ratio']:.2f}"
        if here["ci95"] is not None:
            text += " ({:.2f} to {:.2f})".format(*here["ci95"])
    if name not in duel["published"]:
        return text
    rival, network = duel["published"][name]
    return f"{text}; {network / rival:.2f}" if rival else f"{text}; rival had 0"


def _name(drive: Drive, version: str) -> str:
    """Return a name that another world, controller, option, length or set of figures changes."""
    controllers = [_told(spec, drive.seed) for spec in drive.controllers]
    told = json.dumps([drive.address, drive.frames, version, controllers, list(FIGURES)])
    return f"seed-{drive.seed}-{hashlib.sha256(told.encode()).hexdigest()[:12]}"


def _told(spec: str, seed: int) -> tuple[str, dict[str, str]]:
    """Return a controller with all its options; of a network what is in its file."""
    named = make_controller(spec, seed=seed, networks=shipped_networks())
    options = dict(named.options)
    if named.model is not None:
        options["model"] = hashlib.sha256(named.model.read_bytes()).hexdigest()
    return spec, options
