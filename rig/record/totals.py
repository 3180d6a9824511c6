"""How many triggers, how many complete pairs, and why the others are not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

NAME = "rig.totals"
_LOST = "lost: "


@dataclass(slots=True)
class Totals:
    """A count of triggers; triggers = complete + the sum of `lost`, always."""

    complete: int = 0
    lost: dict[str, int] = field(default_factory=dict)

    @property
    def triggers(self) -> int:
        """Return the number of triggers counted."""
        return self.complete + sum(self.lost.values())

    def add(self, cause: str) -> None:
        """Count one trigger; an empty cause is a complete pair."""
        if cause:
            self.lost[cause] = self.lost.get(cause, 0) + 1
        else:
            self.complete += 1

    def to_metadata(self) -> dict[str, str]:
        """Return the counts as an MCAP metadata record."""
        lost = {f"{_LOST}{cause}": str(count) for cause, count in self.lost.items()}
        return {"triggers": str(self.triggers), "complete": str(self.complete), **lost}

    @staticmethod
    def from_metadata(values: Mapping[str, str]) -> Totals:
        """Return what `to_metadata` wrote; raises KeyError or ValueError for anything else."""
        lost = {
            name.removeprefix(_LOST): int(count)
            for name, count in values.items()
            if name.startswith(_LOST)
        }
        totals = Totals(int(values["complete"]), lost)
        if totals.triggers != int(values["triggers"]):
            raise ValueError(f"{values['triggers']} triggers claimed, {totals.triggers} accounted")
        return totals
