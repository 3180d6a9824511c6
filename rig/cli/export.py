"""`rig export REC --to FORMAT`: a recording in the format of another tool."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path

from rig.cli.exits import OK
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.errors import RigError, UsageError

ARCHIVE = "archive"


def export(recording: Path, /, *, to: str, out: Path, terminal: Terminal = DEFAULT_TERMINAL) -> int:
    """Write a recording in the format of another tool.

    Parameters
    ----------
    recording:
        A run's folder, its run.mcap, or its metadata.yaml.
    to:
        png (colour pictures), mosaic (the sensor's pixels), euroc (mav0/cam0 ...), kitti or tum
        (true poses of a simulation), mp4, or archive (the same recording, compressed).
    out:
        Folder to make.
    """
    from rig.experiments.export import FORMATS
    from rig.record.archive import archive
    from rig.record.reader import open_recording

    if to != ARCHIVE and to not in FORMATS:
        known = [*FORMATS, ARCHIVE]
        close = get_close_matches(to, known, n=1)
        hint = f"did you mean {close[0]!r}? " if close else ""
        raise UsageError(f"--to {to!r} is no format; {hint}known: {', '.join(known)}")
    if out.exists():
        raise RigError(f"--out {out} exists, nothing is overwritten: name a new one")
    opened = open_recording(recording)
    if to == ARCHIVE:
        total = sum(part.stat().st_size for part in opened.parts)
        with terminal.progress("archiving", total) as advance:
            archive(opened, out, advance)
    else:
        with terminal.progress("exporting", len(opened)) as advance:
            FORMATS[to](opened, out, advance)
    files = [path for path in out.rglob("*") if path.is_file()]
    size_mb = sum(path.stat().st_size for path in files) / 1e6
    values = {"recording": str(opened.path), "format": to, "folder": str(out)}
    terminal.result(
        f"{out}: {len(files)} files, {size_mb:.1f} MB",
        {**values, "files": len(files), "size_mb": size_mb},
    )
    return OK
