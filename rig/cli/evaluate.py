"""`rig evaluate REC...`: judge recordings, videos, or folders of pictures, and rank controllers."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rig.bulk import Workers, run_tasks
from rig.cli.exits import OK
from rig.cli.judge import judge, table
from rig.cli.options import make_folder
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.errors import RigError, UsageError
from rig.evaluation.aggregate import aggregate
from rig.evaluation.front_ends import FrontEnds, parse_front_ends
from rig.evaluation.odometry import write_tum
from rig.evaluation.pictures import judge_pictures
from rig.evaluation.summary import RACE_SIDES, Summary, summarise
from rig.record.reader import open_recording

FRONT_END_TITLES = {"orb": "ORB", "viso2": "viso2-style"}
RECORDING_SUFFIXES = {".mcap", ".yaml"}


def evaluate(
    *recordings: Path,
    front_end: str = "orb,viso2",
    step: int = 1,
    trajectories: Path | None = None,
    workers: int | None = None,
    dask: str = "",
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Judge recordings by a visual-odometry front end and rank the controllers that drove them.

    A video or a folder of pictures is judged as well, without settings.

    Parameters
    ----------
    recordings:
        Runs, or videos, or folders of pictures.
    front_end:
        Front ends with their options, both when absent, as races are judged: orb, viso2,
        orb:size=full,features=5000,viso2:half=no, ...
        orb has size (WIDTHxHEIGHT or full), features, threshold_px, estimator (ransac or magsac)
        and geometry (fundamental or essential); viso2 has half (yes or no), height_m
        and pitch_deg (negative looks down).
    step:
        Take every n-th picture of a video or a folder.
    trajectories:
        Folder to make, for the ways that viso2 told and the true ones, as TUM files.
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
    if trajectories is not None:
        if "viso2" not in front_ends:
            raise UsageError("--trajectories needs odometry: add --front-end orb,viso2")
        make_folder(trajectories)
    runs = [path for path in recordings if is_recording(path)]
    films = [path for path in recordings if not is_recording(path)]
    judged = judge_runs(runs, front_end, Workers(workers, dask), terminal)
    if trajectories is not None:
        for path, summary in zip(runs, judged, strict=True):
            write_ways(trajectories, path, summary)
    summaries = [summary.as_json() for summary in judged]
    pictures = {str(path): film(path, step, front_ends, terminal) for path in films}
    values = aggregate(summaries) | ({"pictures": pictures} if pictures else {})
    terminal.result(words(values), values)
    return OK


def judge_runs(
    runs: list[Path], front_end: str, workers: Workers, terminal: Terminal
) -> list[Summary]:
    """Judge recordings side by side, in their order; a single one shows its triggers go by."""
    if len(runs) < 2 and not workers.dask:
        front_ends = parse_front_ends(front_end)
        return [judge(open_recording(path), terminal, front_ends) for path in runs]
    tasks = {f"{number}: {path}": path for number, path in enumerate(runs, start=1)}
    found: dict[str, Summary] = {}
    with terminal.progress("judging recordings", len(tasks)) as advance:
        for name, summary in run_tasks(partial(judge_run, front_end), tasks, workers):
            found[name] = summary
            advance(len(found))
    return [found[name] for name in tasks]


def judge_run(front_end: str, path: Path) -> Summary:
    """Judge one recording, in whatever process."""
    return summarise(open_recording(path), parse_front_ends(front_end))


def write_ways(folder: Path, run: Path, summary: Summary) -> None:
    """Write both cameras' ways of a run, and the true one where it is known, as TUM files."""
    series = summary.series
    came = np.isfinite(series.time_s)
    times_s = dict(zip(series.trigger[came].tolist(), series.time_s[came].tolist(), strict=True))
    name = run.stem if run.is_file() else run.name
    for side in RACE_SIDES:
        odometry = summary.camera(side).odometry
        if odometry is None:
            continue
        write_tum(folder / f"{name}-{side}.tum", times_s, odometry.estimated)
        if len(odometry.truth):
            write_tum(folder / f"{name}-truth.tum", times_s, odometry.truth.only(times_s))


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
    lines = [table(values["runs"])] if values["runs"] else []
    for pair, result in values["paired"].items():
        interval = result["ci95"]
        sure = (
            f"95 % {interval[0]:.2f} to {interval[1]:.2f}" if interval else "one run: no interval"
        )
        ratio = result["orb_median_ratio"]
        told = "no ratio" if ratio is None else f"median ratio {ratio:.2f}"
        lines.append(f"{pair}: {told} ({sure}), won {result['wins']}, lost {result['losses']}")
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
