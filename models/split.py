"""Which recordings train and which are held back: whole worlds, never single frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Generic, Protocol, TypeVar
from urllib.parse import parse_qs

import numpy as np

from rig.core.errors import UsageError

WORLDS_PER_HELD_BACK = 5


class Origin(Protocol):
    """Where training data came from: a name for people, a digest, and the cameras' address."""

    @property
    def name(self) -> str: ...  # noqa: D102

    @property
    def sha256(self) -> str: ...  # noqa: D102

    @property
    def cameras(self) -> str: ...  # noqa: D102


From = TypeVar("From", bound=Origin)


@dataclass(frozen=True, slots=True)
class Split(Generic[From]):
    """The recordings of both sides; no world is on both unless a person held it back by name."""

    training: tuple[From, ...]
    held_back: tuple[From, ...]


def hold_back(recordings: Sequence[From], names: Sequence[str], seed: int) -> Split[From]:
    """Hold back the named recordings, or one world in five, at least one, drawn by `seed`.

    Of a single world nothing is held back. Raises UsageError for an unknown name and when nothing
    is left to train on.
    """
    held = _by_name(recordings, names) if names else _by_world(recordings, seed)
    split = Split(
        tuple(recording for recording in recordings if recording.sha256 not in held),
        tuple(recording for recording in recordings if recording.sha256 in held),
    )
    if not split.training:
        raise UsageError("every recording is held back: leave at least one to train on")
    return split


def world_of(recording: Origin) -> str:
    """Return what two recordings of one simulated world share; a real drive is its own world."""
    scene, _, query = recording.cameras.removeprefix("gige:").partition("?")
    if not scene.startswith("sim:"):
        return recording.sha256
    options = parse_qs(query)
    split, seed = options.get("split", ["train"]), options.get("seed", ["0"])
    return f"{scene}?split={split[0]}&seed={seed[0]}"


def _by_name(recordings: Sequence[Origin], names: Sequence[str]) -> frozenset[str]:
    known = {recording.name for recording in recordings}
    for name in names:
        if name not in known:
            close = get_close_matches(name, known, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"there are {sorted(known)}"
            raise UsageError(f"no recording {name!r} to hold back: {hint}")
    return frozenset(recording.sha256 for recording in recordings if recording.name in names)


def _by_world(recordings: Sequence[Origin], seed: int) -> frozenset[str]:
    worlds = sorted({world_of(recording) for recording in recordings})
    if len(worlds) < 2:
        return frozenset()
    count = max(1, len(worlds) // WORLDS_PER_HELD_BACK)
    held = set(np.random.default_rng(seed).permutation(worlds)[:count].tolist())
    return frozenset(recording.sha256 for recording in recordings if world_of(recording) in held)
