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
from rig.models.scoremap.grid import SettingsGrid

Values = NDArray[np.float32]

_LOST_PER_EV2 = 1.4
_LOST_AT_EXITS_PER_EV2 = 2.8


@dataclass(frozen=True, slots=True)
class Utility:
    """The worth of n matches: `log_weight` ln(n + 50) - `fear` exp(-n / `fear_falloff`).

    The logarithm makes a share of matches worth the same everywhere. Fear is about the worst pair
    alone: at 20 matches it outweighs most that could follow, at 80 it is nothing, so a way of
    several poor pairs is taken where it spares a very poor one. `discount` in [0, 1) is per frame.
    `opposed_cost` is for each stop that exposure and gain move against each other: the pictures
    are as bright as before, but blurred and noisy in another way. `other_weight`, `other_fear` and
    `other_falloff` are the same of the inliers of the other front end: the logarithm is of those to
    expect, fear is about those that a change leaves where it does most harm (`change_worth`).
    `lost_cost` is for a pair that tells visual odometry no motion, though it may have matches
    enough: all of them far away, while the vehicle crawls.
    """

    log_weight: float = 0.3
    fear: float = 30.0
    fear_falloff: float = 10.0
    discount: float = 0.95
    opposed_cost: float = 0.02
    other_weight: float = 0.15
    other_fear: float = 12.0
    other_falloff: float = 25.0
    lost_cost: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.discount < 1:
            raise UsageError(f"the discount must be in [0, 1), got {self.discount}")

    @property
    def front_end(self) -> str:
        """Return whose matches are worth anything: a name of UTILITIES."""
        if not (self.other_weight or self.other_fear or self.lost_cost):
            return "orb"
        return "both" if self.log_weight or self.fear else "viso2"

    def of(self, matches: Values) -> Values:
        """Return the utility of each count."""
        return _logarithm(matches, self.log_weight) - _fear(matches, self.fear, self.fear_falloff)

    def of_other(self, inliers: Values, at_exits: Values) -> Values:
        """Return the utility of each count of the other front end, as usual and at exits."""
        feared = _fear(at_exits, self.other_fear, self.other_falloff)
        return _logarithm(inliers, self.other_weight) - feared


UTILITIES: Mapping[str, Utility] = {
    "both": Utility(),
    "orb": Utility(other_weight=0.0, other_fear=0.0),
    "viso2": Utility(log_weight=0.0, fear=0.0, other_weight=0.3, other_fear=24.0, lost_cost=2.0),
}
"""What moves are worth to whoever looks with this front end, or does not know with which."""


def _logarithm(counts: Values, weight: float) -> Values:
    return np.asarray(weight * np.log(counts + 50), np.float32)


def _fear(counts: Values, weight: float, falloff: float) -> Values:
    return np.asarray(weight * np.exp(-counts / falloff), np.float32)


def denoised(counts: NDArray[np.int16] | NDArray[np.bool_]) -> Values:
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
    were left without a change (docs/learning-trials.md); where there are more, a change costs less.
    """
    return np.asarray(np.exp(-_LOST_PER_EV2 * np.square(changed_ev)))


def kept_share_at_exits(changed_ev: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share that a change leaves at the exit of a tunnel: 0.5 at half a stop.

    There the view is dark and white at once, and there the worst pairs of drives lie. Fitted to
    changes of up to 0.6 stops in 13 poses before the exits of three train tunnels
    (docs/learning-trials.md); of larger ones more is left.
    """
    return np.asarray(np.exp(-_LOST_AT_EXITS_PER_EV2 * np.square(changed_ev)))


@dataclass(frozen=True, slots=True, eq=False)
class Staying:
    """What the other front end gets where a setting stays: inliers, and the share 0..1 of motions.

    Both of one shape, ... x N settings.
    """

    inliers: Values
    told: Values


def staying(steady: NDArray[np.int16], told: NDArray[np.bool_]) -> Staying:
    """Return what a drive's counts, both P-1 x S, promise whoever stays."""
    return Staying(denoised(steady), denoised(told))


def change_worth(
    before: Staying,
    after: Staying,
    settings: NDArray[np.float64],
    utility: Utility,
    grid: SettingsGrid,
) -> Values:
    """Return what moves from N settings to every cell are worth but for their matches, ... x N x S.

    That is the worth of the other front end's inliers and motions, less the cost of swings. The
    poorer of both ends, where it stays, says what there was without a change: `before`, ... x N,
    is that of the settings, N x (exposure_us, gain_db), and `after`, which fits ... x N x S, of
    the cells.
    """
    poorer = np.minimum(before.inliers[..., None], after.inliers)
    changed_ev = grid.distance_ev(settings)
    usual, at_exits = (
        poorer * share(changed_ev).astype(np.float32) for share in (kept_share, kept_share_at_exits)
    )
    lost = utility.lost_cost * (1 - np.minimum(before.told[..., None], after.told))
    swings = (utility.opposed_cost * grid.opposed_ev(settings)).astype(np.float32)
    return np.asarray(utility.of_other(usual, at_exits) - lost - swings, np.float32)


def move_worth(matched: Values, stays: Staying, utility: Utility, grid: SettingsGrid) -> Values:
    """Return the worth of every move by itself, P-1 x S (from) x S (to).

    `matched` is what the matches of the moves are worth, of the same shape, and `stays` what the
    other front end gets where a setting stays, P-1 x S; both of `denoised` counts.
    """
    after = Staying(stays.inliers[:, None], stays.told[:, None])
    return np.asarray(matched + change_worth(stays, after, grid.cells(), utility, grid))


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
