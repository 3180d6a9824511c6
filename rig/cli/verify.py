"""`rig verify REC`: recompute every claim that a recording makes."""

from __future__ import annotations

from pathlib import Path

from rig.cli.exits import FAILED, LOSSES, OK
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal


def verify(recording: Path, /, *, terminal: Terminal = DEFAULT_TERMINAL) -> int:
    """Recompute every claim that a recording makes: pixels, pairing, order, accounting.

    Exit code 0 is sound, 3 sound with recorded losses, 1 a false claim.

    Parameters
    ----------
    recording:
        A run's folder, its run.mcap, or its metadata.yaml.
    """
    from rig.record.verify import verify as recompute

    found = recompute(recording)
    values = {
        "sound": found.sound,
        "pairs": found.pairs,
        "lost": dict(found.lost),
        "false_claims": list(found.false_claims),
    }
    losses = sum(found.lost.values())
    verdict = "sound" if found.sound else "NOT SOUND"
    lines = [f"{recording}: {verdict}, {found.pairs} pairs, {losses} lost"]
    lines += [f"  lost {count}: {cause}" for cause, count in found.lost.items()]
    lines += [f"  false: {claim}" for claim in found.false_claims]
    terminal.result("\n".join(lines), values)
    if not found.sound:
        return FAILED
    return LOSSES if losses else OK
