"""Standing still at places of a drive, as one takes many pictures of a scene from a tripod."""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Standing:
    """`triggers` pictures at each place, places `step_m` apart (thesis 4.2.2: 10 to 50 cm)."""

    triggers: int
    step_m: float

    def __str__(self) -> str:
        """Return it as it is written in an address."""
        return f"{self.triggers}@{self.step_m:g}"


def read_standing(word: str) -> Standing:
    """Return what `25@0.3` names; raises ValueError with what it must be."""
    found = re.fullmatch(r"(\d+)@(\d+(?:\.\d+)?)", word)
    if not found or int(found[1]) == 0 or float(found[2]) == 0:
        raise ValueError("triggers and metres between places, both above 0, such as 25@0.3")
    return Standing(int(found[1]), float(found[2]))
