"""`rig report REC...`: judge recordings again and write their reports anew."""

from __future__ import annotations

from pathlib import Path

from rig.cli.exits import OK
from rig.cli.judge import Watched, publish, words
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.errors import RigError, UsageError
from rig.evaluation.summary import Summary
from rig.evaluation.video import write_video
from rig.record.container import find
from rig.record.reader import open_recording


def report(
    *recordings: Path,
    pictures: bool = True,
    video: Path | None = None,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Write summary.json and report.html beside each recording, replacing what is there.

    The JSON is that of summary.json; of several recordings a list of them, `runs`.

    Parameters
    ----------
    recordings:
        Folders of runs, their run.mcap, or their metadata.yaml.
    pictures:
        Show the moments worth looking at; a page without them is a small one.
    video:
        Film to make of one recording as well, OUT.mp4: both cameras with settings and inliers.
    """
    if not recordings:
        raise UsageError("nothing to report on: name a recording")
    if video is not None:
        check_video(video, recordings)
    summaries = {}
    for recording in recordings:
        folder = find(recording).parent
        summaries[folder] = publish(folder, terminal, pictures=pictures)
        if video is not None:
            film(video, folder, summaries[folder], terminal)
    values = [summary.as_json() for summary in summaries.values()]
    text = "\n\n".join(words(folder, summary) for folder, summary in summaries.items())
    terminal.result(text, values[0] if len(values) == 1 else {"runs": values})
    return OK


def check_video(video: Path, recordings: tuple[Path, ...]) -> None:
    """Refuse early what would make no film."""
    if len(recordings) != 1:
        raise UsageError(f"--video makes one film: name one recording, not {len(recordings)}")
    if video.suffix != ".mp4":
        raise UsageError(f"--video {video}: the film is an MP4, name a file that ends in .mp4")
    if video.exists():
        raise RigError(f"--video {video} exists, nothing is overwritten: name a new file")
    if not video.parent.is_dir():
        raise RigError(f"--video {video}: there is no folder {video.parent}; make it first")


def film(video: Path, folder: Path, summary: Summary, terminal: Terminal) -> None:
    """Write the film of a recorded run, showing progress over its triggers."""
    recording = open_recording(folder)
    with terminal.progress("filming", len(recording)) as advance:
        write_video(video, Watched(recording, advance), summary)
    terminal.say(f"video: {video}")
