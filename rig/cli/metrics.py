"""`rig metrics IMAGE...`: what the metrics of the field say of pictures."""

from __future__ import annotations

from pathlib import Path

from rig.cli.exits import OK
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.errors import RigError, UsageError


def metrics(*images: Path, terminal: Terminal = DEFAULT_TERMINAL) -> int:
    """Score pictures by the image metrics of the field, at full size.

    Parameters
    ----------
    images:
        Picture files.
    """
    if not images:
        raise UsageError("nothing to score: name one picture or more")
    values: dict[str, dict[str, float]] = {}
    with terminal.progress("scoring", len(images)) as advance:
        for done, path in enumerate(images, start=1):
            values[str(path)] = score_file(path)
            advance(done)
    terminal.result(words(values), values)
    return OK


def score_file(path: Path) -> dict[str, float]:
    """Return the scores of a picture file; raises RigError when it is none, or too small."""
    import cv2
    import numpy as np

    from rig.vision.metrics import score

    if not path.is_file():
        raise RigError(f"{path}: no such picture; give the path of one")
    bgr = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if bgr is None:
        raise RigError(f"{path}: cannot be read as a picture; repair or remove it")
    try:
        return score(np.asarray(bgr, np.uint8))
    except ValueError as error:
        raise RigError(f"{path}: {error}; give a larger picture") from error


def words(values: dict[str, dict[str, float]]) -> str:
    """Return the scores as lines for a person."""
    lines: list[str] = []
    for path, scores in values.items():
        lines += [path, *(f"  {name:<18}{value:>14.6g}" for name, value in scores.items())]
    return "\n".join(lines)
