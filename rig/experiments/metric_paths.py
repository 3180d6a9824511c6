"""`metric-paths`: which image metric picks the pictures that match best (thesis 4.2.4).

At every place of some trajectories a standing camera takes the same scene with many exposures at
10 dB. A metric picks one picture a place, an M-trajectory; the inlier matches between neighbours
of it say what the metric is worth. Tables 4.2 (median) and 4.3 (minimum) compare the metrics of
the front end, table 4.4 counts how often each metric, of the literature too, is the best one. The
values of each metric over exposure at one place (fig. 3.1) and along one trajectory (fig. 4.8) are
in the JSON.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.bulk import Workers, run_tasks
from rig.controllers.policies import exposure_sweep
from rig.core.types import PixelFormat
from rig.drivers.registry import open_source
from rig.drivers.scenes.scene import Scene
from rig.drivers.sensor.sensor import Sensor
from rig.drivers.simulated.source import SimulatedSource
from rig.experiments.reproduce import Job
from rig.plot import Curve, Curves, svg
from rig.vision.bayer import to_bgr, to_grey
from rig.vision.metrics import score
from rig.vision.orb import OrbFeatures, OrbFrontEnd

GAIN_DB = 10.0
LITERATURE = {
    "entropy": "Lu",
    "shim-gradient": "Shim",
    "gradient-sum": "gradient sum",
    "kim": "Kim",
    "shin-authors": "Shin",
    "zhang-soft": "Zhang",
}
"""Metrics of table 4.4 by the name of `rig metrics`."""

FRONT_END = ("feat", "uni", "grid", "seq")

Cells = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Places `step_s` of the drive apart, from `start_s` on."""

    name: str
    cameras: str
    start_s: float
    step_s: float
    places: int


@dataclass(frozen=True, slots=True)
class Plan:
    """What is looked at: trajectories, how many exposures a place, the size of the pictures."""

    trajectories: tuple[Trajectory, ...]
    exposures: int
    size: str


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """P places under N exposures: scores by metric, P x N, and inliers P-1 x N x N."""

    scores: Mapping[str, NDArray[np.float64]]
    inliers: Cells


FULL = Plan(
    (
        Trajectory("In-Out tunnel A", "sim:tunnel?seed=0", 7.0, 0.1, 12),
        Trajectory("In-Out tunnel B", "sim:tunnel?seed=1", 7.0, 0.1, 12),
        Trajectory("Out-In tunnel A", "sim:tunnel?seed=0", 2.4, 0.1, 12),
        Trajectory("Out-In tunnel B", "sim:tunnel?seed=1", 2.4, 0.1, 12),
        Trajectory("Inside tunnel", "sim:tunnel?seed=2", 5.0, 0.1, 12),
        Trajectory("Road", "sim:road?seed=0", 3.0, 0.1, 12),
        Trajectory("Doorway", "sim:doorway?seed=0", 3.0, 0.2, 12),
        Trajectory("Door, stationary", "sim:door?seed=0", 1.0, 0.4, 12),
        Trajectory("Indoor hallway", "sim:indoor?seed=0&place=hallway", 1.0, 0.2, 12),
        Trajectory("Indoor lab", "sim:indoor?seed=0&place=lab", 1.0, 0.2, 12),
    ),
    exposures=24,
    size="640x480",
)
SMALL = Plan(
    (
        Trajectory("In-Out tunnel", "sim:tunnel?seed=0", 7.2, 0.2, 4),
        Trajectory("Road", "sim:road?seed=0", 3.0, 0.1, 3),
    ),
    exposures=8,
    size="320x240",
)


def compare(job: Job) -> dict[str, Any]:
    """Run the plan, one trajectory a process, and return all tables as they are in JSON."""
    return compare_plan(SMALL if job.quick else FULL, job)


def compare_plan(plan: Plan, job: Job) -> dict[str, Any]:
    """Run a plan; its worlds are those of the train split."""
    count, places = len(plan.trajectories), sum(t.places for t in plan.trajectories)
    job.say(f"SIMULATED: {count} trajectories, {places} places, {plan.exposures} exposures each")
    tasks = {trajectory.name: trajectory for trajectory in plan.trajectories}
    found: dict[str, dict[str, Any]] = {}
    workers = Workers(job.processes)
    for name, values in run_tasks(partial(_walk, plan), tasks, workers):
        found[name] = values
        job.advance(len(found), count)
    rows = {name: found[name] for name in tasks}
    return {
        "schema": "rig.metric-paths/1",
        "split": "train",
        "exposures": plan.exposures,
        "gain_db": GAIN_DB,
        "size": plan.size,
        "trajectories": rows,
        "best": {figure: _winners(rows, figure) for figure in ("median", "min")},
    }


def words(values: Mapping[str, Any]) -> str:
    """Return tables 4.2, 4.3 and 4.4 as Markdown."""
    names = [*FRONT_END, *LITERATURE.values()]
    lines = []
    for number, figure in (("4.2", "median"), ("4.3", "min")):
        lines += [f"Table {number}: {figure} inliers of the M-trajectories", ""]
        lines += ["| trajectory | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
        for trajectory, row in values["trajectories"].items():
            cells = " | ".join(f"{row['paths'][name][figure]:.0f}" for name in names)
            lines.append(f"| {trajectory} | {cells} |")
        lines.append("")
    lines += ["Table 4.4: on how many trajectories each is best, ties counting for all", ""]
    lines += ["| | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for figure, best in values["best"].items():
        lines.append(f"| {figure} | " + " | ".join(f"{best[name]}" for name in names) + " |")
    return "\n".join(lines)


def draw(values: Mapping[str, Any]) -> str:
    """Return fig. 3.1 (metrics over exposure at one place) and 4.8 (along it), a row a trajectory.

    Metrics have units of their own: each is drawn from its lowest value there (0) to its best (1).
    """
    panels = [
        panel
        for name, row in values["trajectories"].items()
        for panel in (_over_exposure(name, row), _along(name, row))
    ]
    return svg(panels)


def _over_exposure(name: str, row: Mapping[str, Any]) -> Curves:
    named = {"features": "feat", "uniformity": "uni", **LITERATURE}
    curves = [
        Curve(metric, row["exposures_us"], _shares(row["scores_of_middle"][key]))
        for key, metric in named.items()
    ]
    return Curves(f"{name}: middle place", curves, "exposure, us", "share", log_across=True)


def _shares(values: Sequence[float]) -> list[float]:
    low, high = min(values), max(values)
    return [(value - low) / (high - low) if high > low else 0.0 for value in values]


def _along(name: str, row: Mapping[str, Any]) -> Curves:
    paths = row["paths"]
    curves = [Curve(m, range(1, len(paths[m]["inliers"]) + 1), paths[m]["inliers"]) for m in paths]
    return Curves(f"{name}: inliers", curves, "place", "ORB inliers")


def choose_paths(seen: Seen) -> dict[str, Cells]:
    """Return the picture that each metric picks at every place, P long, by the metric's name.

    `seq` begins with the most features (eq. 4.7); `grid` takes the later picture of the best two,
    and at the first place the earlier one of them (eq. 4.8).
    """
    paths = {"feat": seen.scores["features"].argmax(1), "uni": seen.scores["uniformity"].argmax(1)}
    best = [np.unravel_index(int(pair.argmax()), pair.shape) for pair in seen.inliers]
    paths["grid"] = np.array([best[0][0], *(later for _, later in best)], np.int64)
    sequence = [int(paths["feat"][0])]
    for pair in seen.inliers:
        sequence.append(int(pair[sequence[-1]].argmax()))
    paths["seq"] = np.array(sequence, np.int64)
    return paths | {name: seen.scores[key].argmax(1) for key, name in LITERATURE.items()}


def _walk(plan: Plan, trajectory: Trajectory) -> dict[str, Any]:
    """Return the trajectory's figures: by metric, and of every exposure at its middle place."""
    settings = exposure_sweep(plan.exposures, GAIN_DB)
    exposures_us = np.array([one.exposure_us for one in settings])
    seen = _see(plan, trajectory)
    entropy, gradients = seen.scores["entropy"], seen.scores["gradient-sum"]
    at = np.arange(len(entropy))
    paths = {}
    for name, path in choose_paths(seen).items():
        inliers = seen.inliers[at[:-1], path[:-1], path[1:]]
        paths[name] = {
            "median": float(np.median(inliers)),
            "min": int(inliers.min()),
            "inliers": inliers.tolist(),
            "exposure_us": exposures_us[path].tolist(),
            "entropy": entropy[at, path].tolist(),
            "gradient_sum": gradients[at, path].tolist(),
        }
    middle = len(entropy) // 2
    return {
        "cameras": trajectory.cameras,
        "paths": paths,
        "exposures_us": exposures_us.tolist(),
        "scores_of_middle": {key: values[middle].tolist() for key, values in seen.scores.items()},
    }


def _see(plan: Plan, trajectory: Trajectory) -> Seen:
    scene, sensor, pixel_format = _open(trajectory.cameras, plan.size)
    settings, front_end = exposure_sweep(plan.exposures, GAIN_DB), OrbFrontEnd()
    scores: dict[str, list[list[float]]] = {}
    features: list[list[OrbFeatures]] = []
    for place in range(trajectory.places):
        view = scene.view("primary", trajectory.start_s + place * trajectory.step_s)
        pictures = [
            sensor.develop(view.radiance_cd_m2, one, place * len(settings) + number)
            for number, one in enumerate(settings)
        ]
        features.append([front_end.features(to_grey(p, pixel_format)) for p in pictures])
        scored = [score(to_bgr(picture, pixel_format)) for picture in pictures]
        for name in scored[0]:
            scores.setdefault(name, []).append([one[name] for one in scored])
    inliers = [_between(front_end, before, after) for before, after in pairwise(features)]
    return Seen({name: np.array(rows) for name, rows in scores.items()}, np.array(inliers))


def _between(
    front_end: OrbFrontEnd, before: Sequence[OrbFeatures], after: Sequence[OrbFeatures]
) -> list[list[int]]:
    return [[front_end.match(a, b).inliers for b in after] for a in before]


def _open(cameras: str, size: str) -> tuple[Scene, Sensor, PixelFormat]:
    source = open_source(f"{cameras}&size={size}", seed=0, split="train")
    assert isinstance(source, SimulatedSource)
    lens = source.scene.intrinsics("primary")
    model = source.drive.model
    sensor = Sensor(model, (lens.height_px, lens.width_px), seed=0)
    return source.scene, sensor, model.picture.format


def _winners(rows: Mapping[str, Mapping[str, Any]], figure: str) -> dict[str, int]:
    """Return on how many trajectories each metric's figure is the largest."""
    wins: dict[str, int] = dict.fromkeys((*FRONT_END, *LITERATURE.values()), 0)
    for row in rows.values():
        best = max(path[figure] for path in row["paths"].values())
        for name, path in row["paths"].items():
            wins[name] += path[figure] == best
    return wins
