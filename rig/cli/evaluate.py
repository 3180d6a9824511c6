"""`rig evaluate REC...`: judge recordings, videos, or folders of pictures, and rank controllers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from rig.bulk import Workers, run_tasks
from rig.cli.attach import check_attached
from rig.cli.exits import OK
from rig.cli.judge import REPORT, figure, judge, table, with_ceiling
from rig.cli.options import is_simulated, make_folder, run_folder
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.errors import RigError, UsageError
from rig.evaluation.aggregate import aggregate
from rig.evaluation.differences import differences
from rig.evaluation.front_ends import FRONT_ENDS, FrontEnds, parse_front_ends
from rig.evaluation.odometry import write_tum
from rig.evaluation.pictures import judge_pictures, natural_order
from rig.evaluation.report.league import ranking, write_league
from rig.evaluation.report.verdict import shares_text
from rig.evaluation.report.wording import failed
from rig.evaluation.statistics import WARM_UP_PAIRS
from rig.evaluation.summary import RACE_SIDES, Summary
from rig.record.container import find
from rig.record.reader import open_recording

FRONT_END_TITLES = {"orb": "ORB", "viso2": "viso2-style"}
SILENT = Terminal(quiet=True)
RECORDING_SUFFIXES = {".mcap", ".yaml"}


def evaluate(
    *recordings: Path,
    front_end: str = "orb,viso2",
    step: int = 1,
    undistort: Annotated[bool, Parameter(negative="")] = False,
    trajectories: Path | None = None,
    out: Path | None = None,
    workers: int | None = None,
    dask: str = "",
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Judge recordings by a visual-odometry front end and rank the controllers that drove them.

    A video or a folder of pictures is judged as well, without settings.

    Parameters
    ----------
    recordings:
        Runs, folders of runs as `rig race --seeds` leaves them, videos, folders of pictures.
    front_end:
        Front ends with their options, both when absent, as races are judged: orb, viso2,
        orb:size=full,features=5000,viso2:half=no, ...
        orb has size (WIDTHxHEIGHT or full), features, threshold_px, estimator (ransac or magsac)
        and geometry (fundamental or essential); viso2 has half (yes or no), height_m
        and pitch_deg (negative looks down).
    step:
        Take every n-th picture of a video or a folder.
    undistort:
        Take the lens distortion out first, by the calibration that each recording carries.
    trajectories:
        Folder to make, for the ways that viso2 told and the true ones, as TUM files.
    out:
        Folder to make, for evaluation.json and a report.html of all recordings.
    workers:
        How many recordings to judge at once; one a core when absent.
    dask:
        Address of a Dask scheduler whose workers do it instead, such as tcp://10.0.0.5:8786.
    """
    if not recordings:
        raise UsageError("nothing to evaluate: name a recording, a video, or a folder of pictures")
    if step < 1:
        raise UsageError(f"--step must be at least 1, got {step}")
    front_ends = parse_front_ends(front_end)
    if trajectories is not None and "viso2" not in front_ends:
        raise UsageError("--trajectories needs odometry: add --front-end orb,viso2")
    paths = [inner for path in recordings for inner in unfolded(path)]
    runs = [path for path in paths if is_recording(path)]
    films = [path for path in paths if not is_recording(path)]
    _refuse_twice([*(find(run) for run in runs), *films])
    if undistort and films:
        raise UsageError(f"--undistort: {films[0]} carries no calibration; leave it out")
    for folder in (trajectories, out):
        if folder is not None:
            run_folder(folder, "evaluate")
    for path in runs:
        check_attached(open_recording(path), terminal)
    how = How(front_end, undistort)
    judged = judge_runs(runs, how, Workers(workers, dask), terminal)
    if trajectories is not None:
        make_folder(trajectories)
        for name, summary in zip(names_of(runs), judged, strict=True):
            write_ways(trajectories, name, summary)
    pictures = {str(path): film(path, step, front_ends, terminal) for path in films}
    values = together(judged) | ({"pictures": pictures} if pictures else {})
    text = words(values)
    if out is not None:
        make_folder(out)
        publish_league(out, values)
        text += f"\nreport: {out / REPORT}"
    terminal.result(text, values)
    return OK


def _refuse_twice(paths: Sequence[Path]) -> None:
    """Raise UsageError for what is named twice: it would count as two drives."""
    places = [path.resolve() for path in paths]
    for path, place in zip(paths, places, strict=True):
        if places.count(place) > 1:
            raise UsageError(f"{path} is named twice: it would count as two; name it once")


def publish_league(folder: Path, values: dict[str, Any]) -> None:
    """Write evaluation.json and report.html of many runs into a folder that is there."""
    text = json.dumps(values, indent=2)
    (folder / "evaluation.json").write_text(text + "\n", encoding="utf-8")
    write_league(folder / REPORT, values)


def together(judged: Sequence[Summary]) -> dict[str, Any]:
    """Return the content of evaluation.json: means, ratios and differences over judged runs."""
    runs = [summary.as_json() for summary in judged]
    return {**aggregate(runs), "differences": differences(judged)}


@dataclass(frozen=True, slots=True)
class How:
    """How recordings are judged."""

    front_end: str
    undistort: bool

    @property
    def orb_as_races(self) -> bool:
        """Return whether ORB inliers are counted by the recipe of races, so of bounds."""
        recipe = parse_front_ends(self.front_end).get("orb")
        return recipe == FRONT_ENDS["orb"] and not self.undistort


def judge_runs(runs: list[Path], how: How, workers: Workers, terminal: Terminal) -> list[Summary]:
    """Judge recordings side by side, in their order; a single one shows its triggers go by."""
    if len(runs) < 2 and not workers.dask:
        return [judge_run(how, path, terminal) for path in runs]
    tasks = {f"{number}: {path}": path for number, path in enumerate(runs, start=1)}
    found: dict[str, Summary] = {}
    with terminal.progress("judging recordings", len(tasks)) as advance:
        for name, summary in run_tasks(partial(judge_run, how), tasks, workers):
            found[name] = summary
            advance(len(found))
    return [found[name] for name in tasks]


def judge_run(how: How, path: Path, terminal: Terminal = SILENT) -> Summary:
    """Judge one recording, in whatever process."""
    front_ends = parse_front_ends(how.front_end)
    judged = judge(open_recording(path), terminal, front_ends, undistort=how.undistort)
    return with_ceiling(judged) if how.orb_as_races else judged


def names_of(runs: Sequence[Path]) -> list[str]:
    """Return a name for each run, its folder's; numbered where two have the same."""
    names: list[str] = []
    for run in runs:
        name = (run.parent if run.is_file() else run).resolve().name
        taken = sum(1 for other in names if other == name or other.startswith(f"{name}_"))
        names.append(f"{name}_{taken + 1}" if taken else name)
    return names


def write_ways(folder: Path, name: str, summary: Summary) -> None:
    """Write both cameras' ways of a run, and the true one where it is known, as TUM files.

    They begin where counting does: the errors in summary.json are those of these files.
    """
    series = summary.series
    came = np.isfinite(series.time_s)
    times_s = dict(zip(series.trigger[came].tolist(), series.time_s[came].tolist(), strict=True))
    for side in RACE_SIDES:
        odometry = summary.camera(side).odometry
        if odometry is None:
            continue
        write_tum(folder / f"{name}-{side}.tum", times_s, odometry.way(WARM_UP_PAIRS))
        true = odometry.truth.only(times_s).since(WARM_UP_PAIRS - 1)
        if len(true):
            write_tum(folder / f"{name}-truth.tum", times_s, true)


def unfolded(path: Path) -> list[Path]:
    """Return the runs in a folder of runs, as a race over seeds leaves; else the path itself."""
    if not path.is_dir() or any(path.glob("*.mcap")):
        return [path]
    runs = {file.parent for file in path.glob("*/*.mcap")}
    return sorted(runs, key=natural_order) or [path]


def is_recording(path: Path) -> bool:
    """Return whether a path is a run rather than pictures; raises RigError when it is nothing."""
    if not path.exists():
        raise RigError(f"{path}: no such recording, video or folder")
    return path.suffix in RECORDING_SUFFIXES or (path.is_dir() and any(path.glob("*.mcap")))


def film(path: Path, step: int, front_ends: FrontEnds, terminal: Terminal) -> dict[str, Any]:
    """Return the statistics of a video or a folder of pictures."""
    terminal.say(f"judging {path}")
    series = judge_pictures(path, step=step, front_ends=front_ends)
    return {"pictures": len(series.mean_grey_dn), **series.statistics()}


def words(values: dict[str, Any]) -> str:
    """Return an evaluation as lines for a person."""
    runs = values["runs"]
    lines = _cautions(runs)
    lines += [league(values) if len(runs) > 1 else table(runs)] if runs else []
    lines += [
        duel(pair, result, values["differences"][pair]) for pair, result in values["paired"].items()
    ]
    lines += [
        nearness(name, told) for name, told in values["by_controller"].items() if "of_bound" in told
    ]
    for path, told in values.get("pictures", {}).items():
        for name, title in FRONT_END_TITLES.items():
            if name in told:
                median = told[name]["median"]
                middle = f"{median:.0f}" if median is not None else "-"
                lines.append(
                    f"{path}: {told['pictures']} pictures, "
                    f"{title} median {middle}, min {told[name]['min']}"
                )
    return "\n".join(lines)


def _cautions(runs: list[dict[str, Any]]) -> list[str]:
    """Return what a reader must know before the figures: simulations, controllers that failed."""
    simulated = sum(is_simulated(run["cameras"]) for run in runs)
    lines = [f"SIMULATED: {simulated} of {len(runs)} runs"] if simulated else []
    sides = [(run, run[name]) for run in runs for name in RACE_SIDES]
    return lines + [
        f"{failed(side['controller'], side['held'])}, on {run['cameras']}"
        for run, side in sides
        if side["held"]
    ]


def nearness(controller: str, told: dict[str, Any]) -> str:
    """Return which share of the bound a controller reached, over the runs where it is known."""
    near = told["of_bound"]
    return f"{controller}: {shares_text(near)} of the bound, mean of {near['runs']} runs"


def league(values: dict[str, Any]) -> str:
    """Return one line a controller, the best median of ORB inliers first: means over its runs."""
    titles = f"{'ORB median':>12}{'min':>6}{'blind':>7}{'viso2 median':>14}{'min':>6}{'moved %':>9}"
    lines = [f"{'':>3} {'controller':<28}{'runs':>5}{titles}{'won':>6}{'lost':>5}"]
    for place, (name, told, (won, lost)) in enumerate(ranking(values), start=1):
        orb, viso2 = told.get("orb", {}), told.get("viso2", {})
        cells = [
            figure(orb.get("median"), 12),
            figure(orb.get("min"), 6),
            figure(orb.get("blind_frames"), 7, places=1),
            figure(viso2.get("median"), 14),
            figure(viso2.get("min"), 6),
            figure(viso2.get("frames_processed_pct"), 9),
        ]
        line = f"{place:>3} {name:<28.28}{told['runs']:>5}{''.join(cells)}{won:>6}{lost:>5}"
        lines.append(line)
    return "\n".join(lines)


def duel(pair: str, result: dict[str, Any], apart: dict[str, Any]) -> str:
    """Return how two controllers did side by side: the ratio of medians, then the difference."""
    ratio, interval, orb = result["orb_median_ratio"], result["ci95"], apart["orb"]
    told = "no ratio" if ratio is None else f"median ratio {ratio:.2f}"
    sure = f"95 % {interval[0]:.2f} to {interval[1]:.2f}" if interval else "no interval"
    sure = "one run: no interval" if orb["runs"] == 1 else sure
    more = f"{orb['mean']['difference']:+.0f} ORB inliers a moment"
    if orb["mean"]["ci95"]:
        more += " (95 % {:+.0f} to {:+.0f})".format(*orb["mean"]["ci95"])
    return f"{pair}: {told} ({sure}), {more}, won {result['wins']}, lost {result['losses']}"
