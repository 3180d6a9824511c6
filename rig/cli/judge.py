"""From a recording to summary.json, report.html and the lines that a person reads."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rig.calibration.undistorted import undistorted
from rig.cli.attach import taken_on
from rig.cli.terminal import Advance, Terminal
from rig.core.types import PairRecord
from rig.evaluation.ceiling import Ceiling
from rig.evaluation.front_ends import FRONT_ENDS, FrontEnds
from rig.evaluation.report.page import write_report
from rig.evaluation.report.verdict import nearness, verdict
from rig.evaluation.statistics import WARM_UP_PAIRS
from rig.evaluation.summary import Summary, summarise
from rig.record.header import RunHeader
from rig.record.reader import Recording, open_recording

REPORT = "report.html"


@dataclass(frozen=True, slots=True)
class Watched:
    """A recording that tells a progress bar how much of it was read."""

    recording: Recording
    advance: Advance

    @property
    def header(self) -> RunHeader:
        """Return what the run was."""
        return self.recording.header

    def records(self) -> Iterator[PairRecord]:
        """Return the records in order."""
        for done, record in enumerate(self.recording.records(), start=1):
            self.advance(done)
            yield record


def judge(
    recording: Recording,
    terminal: Terminal,
    front_ends: FrontEnds = FRONT_ENDS,
    *,
    undistort: bool = False,
) -> Summary:
    """Return what a recording came to, showing progress over its triggers.

    Raises CalibrationError when it is to be undistorted and carries no calibration for that.
    """
    with terminal.progress("judging", len(recording)) as advance:
        watched = Watched(recording, advance)
        if not undistort:
            return summarise(watched, front_ends)
        flat = undistorted(watched, str(recording.path), taken_on(recording))
        return summarise(flat, front_ends)


def publish(folder: Path, terminal: Terminal, *, pictures: bool = True) -> Summary:
    """Judge a recorded run and write summary.json and report.html beside it."""
    recording = open_recording(folder)
    summary = with_ceiling(judge(recording, terminal))
    values = json.dumps(summary.as_json(), indent=2)
    (folder / "summary.json").write_text(values + "\n", encoding="utf-8")
    write_report(folder / REPORT, recording, summary, pictures=pictures)
    return summary


def with_ceiling(summary: Summary) -> Summary:
    """Return the summary with the bound of its drive, if whole and worked out before."""
    from rig.experiments.known_bounds import known_bound

    known = known_bound(summary.header.cameras, summary.header.world_version)
    if known is None or known.pairs != len(summary.series) - WARM_UP_PAIRS:
        return summary
    return replace(summary, ceiling=Ceiling(known.best_median, known.best_min))


def tell(folder: Path, summary: Summary, terminal: Terminal) -> None:
    """Print the verdict, a table, and where the report is."""
    terminal.result(words(folder, summary), summary.as_json())


def words(folder: Path, summary: Summary) -> str:
    """Return the verdict, a table, and where the report is."""
    near = nearness(summary)
    lines = [verdict(summary), table([summary.as_json()]), *([near] if near else [])]
    return "\n".join([*lines, f"report: {folder / REPORT}"])


def table(runs: list[dict[str, Any]]) -> str:
    """Return one line a controller and front end: inliers, odometry, settings."""
    inliers = f"{'':>6}{'median':>8}{'min':>6}{'blind':>7}{'moved %':>9}"
    titles = f"{inliers}{'exposure us':>14}{'gain dB':>9}"
    lines = [f"{'controller':<28}{titles}"]
    for run in runs:
        for side in ("left", "right"):
            lines += [_row(run[side], name) for name in FRONT_ENDS if name in run[side]]
    return "\n".join(lines)


def _row(side: dict[str, Any], front_end: str) -> str:
    inliers = side[front_end]
    cells = [
        f"{front_end:>6}",
        figure(inliers["median"], 8),
        figure(inliers["min"], 6),
        figure(inliers["blind_frames"], 7),
        figure(inliers.get("frames_processed_pct"), 9),
        figure(side["exposure_us"][1], 14),
        figure(side["gain_db"][1], 9, places=1),
    ]
    return f"{side['controller']:<28.28}{''.join(cells)}"


def figure(value: float | None, width: int, places: int = 0) -> str:
    """Return a number in a column of some width; None is a dash."""
    return f"{'-':>{width}}" if value is None else f"{value:>{width}.{places}f}"
