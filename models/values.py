"""How good each next setting is: dynamic programming over inliers, backwards through a drive.

The best setting of one picture is not the best next one: matches need two pictures that fit, and
greedy optima jump. The value of a move is the utility of its matches plus the discounted value of
the best that can follow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.errors import UsageError
from rig.models.grid import SettingsGrid

Values = NDArray[np.float32]

_LOST_PER_EV2 = 1.4


@dataclass(frozen=True, slots=True)
class Utility:
    """The worth of n matches: `log_weight` ln(n + 50) - `fear` exp(-n / `fear_falloff`).

    The logarithm makes a share of matches worth the same everywhere. Fear is about the worst pair
    alone: at 20 matches it outweighs most that could follow, at 80 it is nothing, so a way of
    several poor pairs is taken where it spares a very poor one. `discount` in [0, 1) is per frame.
    `opposed_cost` is for each stop that exposure and gain move against each other: the pictures
    are as bright as before, but blurred and noisy in another way. `other_weight`, `other_fear` and
    `other_falloff` are the same of the inliers to expect of the other front end
    (`expected_inliers`).
    """

    log_weight: float = 0.3
    fear: float = 30.0
    fear_falloff: float = 10.0
    discount: float = 0.95
    opposed_cost: float = 0.02
    other_weight: float = 0.15
    other_fear: float = 6.0
    other_falloff: float = 30.0

    def __post_init__(self) -> None:
        if not 0 <= self.discount < 1:
            raise UsageError(f"the discount must be in [0, 1), got {self.discount}")

    @property
    def front_end(self) -> str:
        """Return whose matches are worth anything: a name of UTILITIES."""
        if not (self.other_weight or self.other_fear):
            return "orb"
        return "both" if self.log_weight or self.fear else "viso2"

    def of(self, matches: Values) -> Values:
        """Return the utility of each count."""
        return _worth(matches, self.log_weight, self.fear, self.fear_falloff)

    def of_other(self, inliers: Values) -> Values:
        """Return the utility of each count of the other front end."""
        return _worth(inliers, self.other_weight, self.other_fear, self.other_falloff)


UTILITIES: Mapping[str, Utility] = {
    "both": Utility(),
    "orb": Utility(other_weight=0.0, other_fear=0.0),
    "viso2": Utility(log_weight=0.0, fear=0.0, other_weight=0.3),
}
"""What moves are worth to whoever looks with this front end, or does not know with which."""


def _worth(counts: Values, log_weight: float, fear: float, falloff: float) -> Values:
    feared = fear * np.exp(-counts / falloff)
    return np.asarray(log_weight * np.log(counts + 50) - feared, np.float32)


def denoised(counts: NDArray[np.int16]) -> Values:
    """Return the mean of each pair's counts with those of the pairs before and after it.

    A path is chosen for its counts, so it would choose the lucky ones: those that the same
    settings do not have again.
    """
    around = np.concatenate([counts[:1], counts, counts[-1:]]).astype(np.float32)
    return np.asarray((around[:-2] + around[1:-1] + around[2:]) / 3)


def kept_share(changed_ev: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share, 0 to 1, of viso2-style inliers that a change by so many stops leaves.

    The front end compares brightness itself: 0.7 are left at half a stop, 0.25 at one and 0.004 at
    two. Fitted to the medians of 3,300 moves in 16 places of three train drives, where 60 to 250
    were left without a change (docs/learning.md); where there are more, a change costs less.
    """
    return np.asarray(np.exp(-_LOST_PER_EV2 * np.square(changed_ev)))


def expected_inliers(steady: Values, distance_ev: NDArray[np.float64]) -> Values:
    """Return the viso2-style inliers to expect of every move, P-1 x S (from) x S (to).

    They are those that the poorer of both settings has where it stays (`steady`, P-1 x S), as far
    as the change of brightness leaves them.
    """
    poorer = np.minimum(steady[:, :, None], steady[:, None, :])
    return np.asarray(poorer * kept_share(distance_ev).astype(np.float32))


def move_worth(
    moves: NDArray[np.int16], steady: NDArray[np.int16], utility: Utility, grid: SettingsGrid
) -> Values:
    """Return the worth of every move by itself, P-1 x S (from) x S (to).

    `moves` and `steady` are those of a drive over the grid, P-1 x S x S and P-1 x S.
    """
    other = expected_inliers(denoised(steady), grid.distance_ev())
    worth = utility.of(denoised(moves)) + utility.of_other(other)
    return np.asarray(worth - (utility.opposed_cost * grid.opposed_ev()).astype(np.float32))


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
