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

    found = repair(recording)
    did = "repaired" if found.repaired else "intact, nothing was changed"
    text = f"{recording}: {did}: {found.triggers} triggers in {found.chunks} chunks"
    if found.repaired:
        text += f"; {found.skipped_chunks} unreadable, {found.dropped_bytes} bytes of tail dropped"
    terminal.result(text, asdict(found))
    return OK
