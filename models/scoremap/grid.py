"""The grid of settings over which paths are planned and score maps are drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.types import THESIS_LIMITS, Limits
from rig.core.units import gain_factor


@dataclass(frozen=True, slots=True)
class SettingsGrid:
    """Exposures in equal ratios and gains in equal steps; cell = exposure index x gains + gain."""

    exposures_us: tuple[float, ...]
    gains_db: tuple[float, ...]

    def __len__(self) -> int:
        return len(self.exposures_us) * len(self.gains_db)

    @property
    def shape(self) -> tuple[int, int]:
        """Return (number of exposures, number of gains)."""
        return len(self.exposures_us), len(self.gains_db)

    def cells(self) -> NDArray[np.float64]:
        """Return the settings of every cell, S x (exposure_us, gain_db)."""
        exposures, gains = np.meshgrid(self.exposures_us, self.gains_db, indexing="ij")
        return np.stack([exposures.ravel(), gains.ravel()], axis=1)

    def distance_ev(self, settings: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return by how much brightness differs between N settings and every cell, N x S, in stops.

        `settings` is N x (exposure_us, gain_db).
        """
        return np.abs(brightness_ev(settings)[:, None] - brightness_ev(self.cells()))

    def opposed_ev(self, settings: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the stops that exposure and gain move against each other by, N x S.

        That is on the way from each of N settings, N x (exposure_us, gain_db), to each cell. Only
        the part of a move along equal brightness counts: 0 where both go the same way.
        """
        (longer_from, stronger_from), (longer_to, stronger_to) = map(
            _exposure_and_gain_ev, (settings, self.cells())
        )
        longer, stronger = longer_to - longer_from[:, None], stronger_to - stronger_from[:, None]
        against = np.minimum(np.abs(longer), np.abs(stronger))
        return np.where(longer * stronger < 0, against, 0.0)

    def relit(self, steps: int) -> NDArray[np.int64]:
        """Return the cell, S long, whose picture each cell gives in light `steps` brighter.

        A step is the ratio of two exposures: so much more light looks like an exposure longer by
        it, but for the blur. Beyond the longest exposure more gain stands for it, as near as the
        grid has it, and beyond the shortest less.
        """
        exposures, gains = self.shape
        row, column = np.divmod(np.arange(len(self)), gains)
        wanted = row + steps
        inside = np.clip(wanted, 0, exposures - 1)
        step_ev = np.log2(self.exposures_us[1] / self.exposures_us[0])
        gain_ev = np.log2(gain_factor(self.gains_db[1]) / gain_factor(self.gains_db[0]))
        more = np.rint((wanted - inside) * step_ev / gain_ev).astype(np.int64)
        return np.asarray(inside * gains + np.clip(column + more, 0, gains - 1))

    def corners(
        self, settings: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the four cells around N settings and their weights, both N x 4.

        `settings` is N x (exposure_us, gain_db); those outside the grid count as on its edge. At
        most three weights are above 0: the corners of more exposure with less gain and of less with
        more, which are about equally bright, and the darkest or the brightest. How many features a
        picture has depends on its brightness first of all, so these stand for it best.
        """
        rows, row_parts = _between(np.log(settings[:, 0]), np.log(self.exposures_us))
        columns, column_parts = _between(settings[:, 1], np.array(self.gains_db))
        lowest = rows * len(self.gains_db) + columns
        across = np.array([0, 1, len(self.gains_db), len(self.gains_db) + 1])
        brighter = row_parts + column_parts - 1
        weights = [
            np.maximum(-brighter, 0),
            column_parts - np.maximum(brighter, 0),
            row_parts - np.maximum(brighter, 0),
            np.maximum(brighter, 0),
        ]
        return lowest[:, None] + across, np.stack(weights, axis=1)


def path_grid(
    n_exposure: int = 13, n_gain: int = 6, limits: Limits = THESIS_LIMITS
) -> SettingsGrid:
    """Return the grid that spans `limits`; both counts at least 2."""
    exposures_us = np.geomspace(*limits.exposure_us, n_exposure)
    gains_db = np.linspace(*limits.gain_db, n_gain)
    return SettingsGrid(tuple(exposures_us.tolist()), tuple(gains_db.tolist()))


def brightness_ev(settings: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the stops of brightness of N x (exposure_us, gain_db): log2 of exposure x gain."""
    exposure_ev, gain_ev = _exposure_and_gain_ev(settings)
    return exposure_ev + gain_ev


def _exposure_and_gain_ev(
    settings: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    gains = np.array([gain_factor(gain) for gain in settings[:, 1]])
    return np.log2(settings[:, 0]), np.log2(gains)


def _between(
    values: NDArray[np.float64], steps: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the step at or below each value, but not the last, and the share of the next."""
    clipped = np.clip(values, steps[0], steps[-1])
    index = np.clip(np.searchsorted(steps, clipped, side="right") - 1, 0, len(steps) - 2)
    return index, (clipped - steps[index]) / (steps[index + 1] - steps[index])
