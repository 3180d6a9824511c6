"""What each controller said of itself: its numbers as curves, its words counted."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from rig.evaluation.statistics import WARM_UP_PAIRS
from rig.evaluation.summary import RACE_SIDES, RaceSide, Summary


@dataclass(frozen=True, slots=True)
class Words:
    """How often a controller said a word about one thing, the most frequent first."""

    side: RaceSide
    about: str
    counts: list[tuple[str, int]]


def spoken(summary: Summary) -> list[Words]:
    """Return the words of both controllers over the counted pairs, such as phase: hold 60."""
    return [
        Words(side, about.replace("_", " "), _count(summary, words))
        for side in RACE_SIDES
        for about, words in summary.camera(side).words.items()
    ]


def _count(summary: Summary, words: tuple[str, ...]) -> list[tuple[str, int]]:
    trigger = summary.series.trigger
    said = (word for k, word in zip(trigger, words, strict=True) if word and k >= WARM_UP_PAIRS)
    return Counter(said).most_common(8)
