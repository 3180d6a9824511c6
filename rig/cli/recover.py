"""`rig recover REC`: make a recording readable again that was cut short."""

from __future__ import annotations

from pathlib import Path

from rig.cli.exits import OK
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal


def recover(recording: Path, /, *, terminal: Terminal = DEFAULT_TERMINAL) -> int:
    """Repair a recording in place: every chunk that is whole is kept, the torn tail is dropped.

    Parameters
    ----------
    recording:
        A run's folder, its run.mcap, or its metadata.yaml.
    """
    from dataclasses import asdict

    from rig.record.recover import recover as repair

    repaired = asdict(repair(recording))
    words = ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in repaired.items())
    terminal.result(f"{recording}: {words}", repaired)
    return OK
