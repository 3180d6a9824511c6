"""`rig evaluate REC...`: judge recordings, videos, or folders of pictures, and rank controllers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rig.cli.exits import OK
from rig.cli.judge import judge, table
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.errors import RigError, UsageError
from rig.evaluation.aggregate import aggregate
from rig.evaluation.pictures import judge_pictures
from rig.evaluation.series import FRONT_ENDS, FrontEnds
from rig.record.reader import open_recording

RECORDING_SUFFIXES = {".mcap", ".yaml"}


def evaluate(
    *recordings: Path,
    front_end: str = "orb",
    step: int = 1,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Judge recordings by a visual-odometry front end and rank the controllers that drove them.

    A video or a folder of pictures is judged as well, without settings.

    Parameters
    ----------
    recordings:
        Runs, or videos, or folders of pictures.
    front_end:
        Front ends, separated by commas; this version has orb.
    step:
        Take every n-th picture of a video or a folder.
    """
    if not recordings:
        raise UsageError("nothing to evaluate: name a recording, a video, or a folder of pictures")
    if step < 1:
        raise UsageError(f"--step must be at least 1, got {step}")
    front_ends = choose(front_end)
    runs = [path for path in recordings if is_recording(path)]
    films = [path for path in recordings if not is_recording(path)]
    summaries = [judge(open_recording(path), terminal, front_ends).as_json() for path in runs]
    pictures = {str(path): film(path, step, front_ends, terminal) for path in films}
    values = aggregate(summaries) | ({"pictures": pictures} if pictures else {})
    terminal.result(words(values), values)
    return OK


def choose(names: str) -> FrontEnds:
    """Return the front ends that `names` lists; raises UsageError for one that there is not."""
    chosen = [name.strip() for name in names.split(",")]
    for name in chosen:
        if name not in FRONT_ENDS:
            known = ", ".join(FRONT_ENDS)
            raise UsageError(f"unknown front end {name!r}; this version has: {known}")
    return {name: FRONT_ENDS[name] for name in chosen}


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
        orb = told["orb"]
        median = f"{orb['median']:.0f}" if orb["median"] is not None else "-"
        lines.append(f"{path}: {told['pictures']} pictures, ORB median {median}, min {orb['min']}")
    return "\n".join(lines)
