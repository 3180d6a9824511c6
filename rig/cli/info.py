"""`rig info REC`: what a person asks of a recording first."""

from __future__ import annotations

from pathlib import Path

from rig.cli.exits import OK
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal


def info(
    recording: Path,
    /,
    *,
    thumbnails: Path | None = None,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Show how long a recording is, what it lost, and which settings it used.

    Parameters
    ----------
    recording:
        A run's folder, its run.mcap, or its metadata.yaml.
    thumbnails:
        Picture to write, a .png: pairs from the beginning to the end, the primary above.
    """
    from rig.record.info import info as look_at

    values = look_at(recording).as_dict()
    if thumbnails is not None:
        from rig.experiments.thumbnails import write_sheet

        shown = write_sheet(recording, thumbnails)
        values["thumbnails"] = {"file": str(thumbnails), "triggers": shown}
    width = max(map(len, values))
    lines = [
        f"{name.replace('_', ' '):<{width}}  {_words(value)}" for name, value in values.items()
    ]
    terminal.result("\n".join(lines), values)
    return OK


def _words(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_words(item)}" for key, item in value.items()) or "none"
    if isinstance(value, list | tuple):
        return " ".join(map(_words, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)
