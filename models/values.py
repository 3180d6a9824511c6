"""How good each next setting is: dynamic programming over inliers, backwards through a drive.

The best setting of one picture is not the best next one: matches need two pictures that fit, and
greedy optima jump. The value of a move is the utility of its matches plus the discounted value of
the best that can follow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import UsageError

Values = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Utility:
    """The worth of n matches: `log_weight` ln(n + 50) - `fear` exp(-n / `fear_falloff`).

    The logarithm makes a share of matches worth the same everywhere. Fear is about the worst pair
    alone: at 20 matches it outweighs any plateau behind them, at 80 it is nothing, so a way of
    several poor pairs is taken where it spares a very poor one. `discount` in [0, 1) is per frame.
    `opposed_cost` is for each stop that exposure and gain move against each other: the pictures
    are as bright as before, but blurred and noisy in another way.
    """

    log_weight: float = 0.3
    fear: float = 100.0
    fear_falloff: float = 10.0
    discount: float = 0.95
    opposed_cost: float = 0.02

    def __post_init__(self) -> None:
        if not 0 <= self.discount < 1:
            raise UsageError(f"the discount must be in [0, 1), got {self.discount}")

    def of(self, matches: NDArray[np.int16]) -> Values:
        """Return the utility of each count."""
        n = matches.astype(np.float32)
        worth = self.log_weight * np.log(n + 50) - self.fear * np.exp(-n / self.fear_falloff)
        return np.asarray(worth, np.float32)


def move_values(
    moves: NDArray[np.int16], utility: Utility, opposed_ev: NDArray[np.float64] | None = None
) -> Values:
    """Return the value of every move, of the shape of `moves`: P-1 x S (from) x S (to).

    `opposed_ev` is that of the grid, S x S; without it such moves cost nothing. Behind the last
    pose nothing follows, so the last frames look less far ahead.
    """
    values = utility.of(moves)
    if opposed_ev is not None:
        values -= (utility.opposed_cost * opposed_ev).astype(np.float32)
    following = np.zeros(moves.shape[1], np.float32)
    for here in values[::-1]:
        here += np.float32(utility.discount) * following
        following = here.max(1)
    return values


def best_path(moves: NDArray[np.int16], utility: Utility) -> NDArray[np.int64]:
    """Return the cell of every pose, P long, along the path of the highest value."""
    values = move_values(moves, utility)
    cell = int(values[0].max(1).argmax())
    path = [cell]
    for here in values:
        cell = int(here[cell].argmax())
        path.append(cell)
    return np.array(path)
