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
    alone: at 20 matches it outweighs most that could follow, at 80 it is nothing, so a way of
    several poor pairs is taken where it spares a very poor one. `discount` in [0, 1) is per frame.
    `opposed_cost` is for each stop that exposure and gain move against each other: the pictures
    are as bright as before, but blurred and noisy in another way. `steady_weight` ln(n + 50) is
    the worth of n inliers that the other front end has where the setting stays.
    """

    log_weight: float = 0.3
    fear: float = 30.0
    fear_falloff: float = 10.0
    discount: float = 0.95
    opposed_cost: float = 0.02
    steady_weight: float = 0.15

    def __post_init__(self) -> None:
        if not 0 <= self.discount < 1:
            raise UsageError(f"the discount must be in [0, 1), got {self.discount}")

    def of(self, matches: Values) -> Values:
        """Return the utility of each count."""
        fear = self.fear * np.exp(-matches / self.fear_falloff)
        return np.asarray(self.log_weight * np.log(matches + 50) - fear, np.float32)

    def of_steady(self, inliers: Values) -> Values:
        """Return the utility of each setting's inliers in the other front end."""
        return np.asarray(self.steady_weight * np.log(inliers + 50), np.float32)


def denoised(counts: NDArray[np.int16]) -> Values:
    """Return the mean of each pair's counts with those of the pairs before and after it.

    A path is chosen for its counts, so it would choose the lucky ones: those that the same
    settings do not have again.
    """
    around = np.concatenate([counts[:1], counts, counts[-1:]]).astype(np.float32)
    return np.asarray((around[:-2] + around[1:-1] + around[2:]) / 3)


def move_worth(
    moves: NDArray[np.int16],
    steady: NDArray[np.int16],
    utility: Utility,
    opposed_ev: NDArray[np.float64],
) -> Values:
    """Return the worth of every move by itself, P-1 x S (from) x S (to).

    `moves` and `steady` are those of a drive, P-1 x S x S and P-1 x S; `opposed_ev` is that of the
    grid, S x S.
    """
    worth = utility.of(denoised(moves)) + utility.of_steady(denoised(steady))[:, None, :]
    return np.asarray(worth - (utility.opposed_cost * opposed_ev).astype(np.float32))


def move_values(worth: Values, discount: float) -> Values:
    """Return the value of every move, of the shape of `worth`: its own and that of what follows.

    Behind the last pose nothing follows, so the last frames look less far ahead.
    """
    values = worth.copy()
    following = np.zeros(worth.shape[1], np.float32)
    for here in values[::-1]:
        here += np.float32(discount) * following
        following = here.max(1)
    return values
