"""`rig info REC`: what a person asks of a recording first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rig.cli.exits import OK
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal

_MOST_LOSSES = 5


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
    from rig.calibration.files import PARTS
    from rig.cli.attach import calibration_of
    from rig.record.info import info as look_at
    from rig.record.reader import open_recording

    values = look_at(recording).as_dict()
    found, warnings = calibration_of(open_recording(recording))
    if found is not None or warnings:
        values["calibration"] = {
            "date": str(found.date) if found else "",
            "lens": found.lens if found else "",
            "parts": [part for part in PARTS if found and getattr(found, part) is not None],
            "warnings": warnings,
        }
    if thumbnails is not None:
        from rig.experiments.thumbnails import write_sheet

        triggers = write_sheet(recording, thumbnails)
        values["thumbnails"] = {"file": str(thumbnails), "triggers": triggers}
    shown = {**values, "losses": _spans(values["losses"])}
    width = max(map(len, shown))
    lines = [f"{name.replace('_', ' '):<{width}}  {_words(value)}" for name, value in shown.items()]
    terminal.result("\n".join(lines), values)
    return OK


def _spans(losses: Sequence[Mapping[str, Any]]) -> str:
    """Return where the first losses lie; a run on a slow disk may have thousands."""
    spans = [
        "{first_trigger}-{last_trigger} ({start_s:.1f}-{end_s:.1f} s)".format(**each)
        for each in losses[:_MOST_LOSSES]
    ]
    more = len(losses) - len(spans)
    return " ".join([*spans, *([f"and {more} more"] if more else [])]) or "none"


def _words(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_words(item)}" for key, item in value.items()) or "none"
    if isinstance(value, list | tuple):
        return " ".join(map(_words, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)
