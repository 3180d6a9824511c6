"""Every setting tried at the same places: how hard a world is, and what the best could do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.config import load_camera_model
from rig.core.types import THESIS_LIMITS, Limits, Settings
from rig.drivers.scenes.scene import Scene
from rig.drivers.sensor.sensor import Sensor
from rig.vision.bayer import to_grey
from rig.vision.orb import OrbFeatures, OrbFrontEnd

Counts = NDArray[np.int64]

_CELLS_A_FRAME = 1 << 12


@dataclass(frozen=True, slots=True)
class SettingsGrid:
    """Exposures, geometric, and gains, even: a cell is (exposure index, gain index)."""

    exposures_us: tuple[float, ...]
    gains_db: tuple[float, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """Return (number of exposures, number of gains)."""
        return len(self.exposures_us), len(self.gains_db)

    def settings(self, cell: tuple[int, int]) -> Settings:
        """Return the settings of one cell."""
        return Settings(self.exposures_us[cell[0]], self.gains_db[cell[1]])

    def on_border(self, cell: tuple[int, int]) -> bool:
        """Return whether a cell lies on the grid's edge."""
        return any(i in (0, n - 1) for i, n in zip(cell, self.shape, strict=True))


def settings_grid(
    n_exposure: int = 10, n_gain: int = 5, limits: Limits = THESIS_LIMITS
) -> SettingsGrid:
    """Return the grid that spans `limits`; both counts at least 2."""
    exposures = np.geomspace(*limits.exposure_us, n_exposure)
    gains = np.linspace(*limits.gain_db, n_gain)
    return SettingsGrid(tuple(exposures.tolist()), tuple(gains.tolist()))


class Bench:
    """One simulated camera in a scene, whose every frame can be taken again with any settings."""

    def __init__(
        self, scene: Scene, camera: str = "blackfly-s-u3-31s4", rate_hz: float = 10.0
    ) -> None:
        lens = scene.intrinsics("primary")
        self._scene = scene
        self._rate_hz = rate_hz
        model = load_camera_model(camera)
        self._pixel_format = model.picture.format
        self._sensor = Sensor(model, (lens.height_px, lens.width_px), seed=0)
        self._front_end = OrbFrontEnd()
        self._last: tuple[int, SettingsGrid, list[OrbFeatures]] | None = None

    @property
    def version(self) -> str:
        """Return the version of the world that the camera looks at."""
        return self._scene.world_version

    def picture(self, frame: int, settings: Settings, noise_seed: int) -> NDArray[np.uint8]:
        """Return the Bayer picture of one frame taken with `settings`."""
        view = self._scene.view("primary", frame / self._rate_hz)
        return self._sensor.develop(view.exposed(settings.exposure_us), settings, noise_seed)

    def settings_map(self, pair: int, grid: SettingsGrid) -> Counts:
        """Return the inliers between frames `pair` and `pair` + 1 for every cell of the grid.

        Both frames use the cell's settings. The noise is fresh for each frame and cell. Pairs in
        their order take half the time: the features of the last frame are kept.
        """
        before, after = self.grid_features(pair, grid), self.grid_features(pair + 1, grid)
        inliers = [self.inliers(a, b) for a, b in zip(before, after, strict=True)]
        return np.array(inliers, np.int64).reshape(grid.shape)

    def inliers(self, before: OrbFeatures, after: OrbFeatures) -> int:
        """Return the inlier matches of two pictures, as races count them."""
        return self._front_end.match(before, after).inliers

    def grid_features(self, frame: int, grid: SettingsGrid) -> list[OrbFeatures]:
        """Return the features of one frame for every cell of the grid, gain by gain.

        Those of the last frame asked for are kept.
        """
        if self._last is None or self._last[:2] != (frame, grid):
            self._last = (frame, grid, self._found(frame, grid))
        return self._last[2]

    def _found(self, frame: int, grid: SettingsGrid) -> list[OrbFeatures]:
        view = self._scene.view("primary", frame / self._rate_hz)
        found: list[OrbFeatures] = []
        for exposure_us in grid.exposures_us:
            radiance = view.exposed(exposure_us)
            for gain_db in grid.gains_db:
                seed = frame * _CELLS_A_FRAME + len(found)
                found.append(self._features(radiance, Settings(exposure_us, gain_db), seed))
        return found

    def play(self, first: int, path: Sequence[Settings], noises: Sequence[int] = (0,)) -> Counts:
        """Return the inliers between consecutive frames, one row of pairs for each of `noises`.

        `path[k]` is used at frame `first` + k. Noises from 0 to 4095 are draws of their own; those
        below the size of a grid are the ones in which its cells were counted.
        """
        rows: list[list[int]] = [[] for _ in noises]
        before: list[OrbFeatures] = []
        for frame, settings in enumerate(path, first):
            after = self._draws(frame, settings, noises)
            for row, a, b in zip(rows, before, after, strict=False):
                row.append(self.inliers(a, b))
            before = after
        return np.array(rows, np.int64)

    def _draws(self, frame: int, settings: Settings, noises: Sequence[int]) -> list[OrbFeatures]:
        view = self._scene.view("primary", frame / self._rate_hz)
        radiance = view.exposed(settings.exposure_us)
        seeds = [frame * _CELLS_A_FRAME + noise for noise in noises]
        return [self._features(radiance, settings, seed) for seed in seeds]

    def _features(
        self, radiance: NDArray[np.float32], settings: Settings, noise_seed: int
    ) -> OrbFeatures:
        picture = self._sensor.develop(radiance, settings, noise_seed)
        return self._front_end.features(to_grey(picture, self._pixel_format))


def best_fixed(maps: Counts) -> tuple[tuple[int, int], int]:
    """Return the cell whose worst pair is best, and that minimum; `maps` is pairs x E x G."""
    worst = maps.min(0)
    cell = np.unravel_index(int(np.argmax(worst)), worst.shape)
    return (int(cell[0]), int(cell[1])), int(worst[cell])


def best_path(maps: Counts, reach: int = 1) -> list[tuple[int, int]]:
    """Return a cell per map: the path whose worst map is best, then whose sum is.

    From one map to the next both indices move by at most `reach`. Dynamic programming.
    """
    floor = _highest_floor(maps, reach)
    value = np.where(maps >= floor, maps.astype(float), -np.inf)
    steps = []
    total = value[0]
    for here in value[1:]:
        best, came_from = _best_neighbour(total, reach)
        steps.append(came_from)
        total = here + best
    cell = _cell(int(np.argmax(total)), total.shape)
    path = [cell]
    for came_from in reversed(steps):
        cell = _cell(int(came_from[cell]), total.shape)
        path.append(cell)
    return path[::-1]


def _highest_floor(maps: Counts, reach: int) -> int:
    reachable = maps[0]
    for here in maps[1:]:
        best, _ = _best_neighbour(reachable.astype(float), reach)
        reachable = np.minimum(here, best).astype(np.int64)
    return int(reachable.max())


def _best_neighbour(
    value: NDArray[np.float64], reach: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return for each cell the best value within `reach`, and that neighbour's flat index."""
    index = np.arange(value.size).reshape(value.shape)
    padded = np.pad(value, reach, constant_values=-np.inf)
    padded_index = np.pad(index, reach)
    rows, columns = value.shape
    window = 2 * reach + 1
    shifted = [
        (slice(i, i + rows), slice(j, j + columns)) for i in range(window) for j in range(window)
    ]
    values = np.stack([padded[part] for part in shifted])
    choice = values.argmax(0)[None]
    indices = np.stack([padded_index[part] for part in shifted])
    best = np.take_along_axis(values, choice, 0)[0]
    return best, np.take_along_axis(indices, choice, 0)[0]


def _cell(flat: int, shape: tuple[int, ...]) -> tuple[int, int]:
    row, column = np.unravel_index(flat, shape)
    return int(row), int(column)
