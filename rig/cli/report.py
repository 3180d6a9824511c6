"""`rig report REC...`: judge recordings again and write their reports anew."""

from __future__ import annotations

from pathlib import Path

from rig.cli.exits import OK
from rig.cli.judge import publish, tell
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal


def report(*recordings: Path, terminal: Terminal = DEFAULT_TERMINAL) -> int:
    """Write summary.json and report.html beside each recording, replacing what is there.

    Parameters
    ----------
    recordings:
        Folders of runs, their run.mcap, or their metadata.yaml.
    """
    for recording in recordings:
        folder = recording if recording.is_dir() else recording.parent
        tell(folder, publish(folder, terminal), terminal)
    return OK
