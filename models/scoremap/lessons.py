"""What seen drives teach: the value of every answer at every decision of a journey."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rig.models.dataset import scale_settings
from rig.models.scoremap.grid import SettingsGrid
from rig.models.scoremap.network import FRAMES
from rig.models.scoremap.rollout import Journey
from rig.models.scoremap.seen import SeenDrive
from rig.models.scoremap.values import (
    Staying,
    Utility,
    Values,
    change_worth,
    denoised,
    move_values,
    move_worth,
    staying,
)


@dataclass(frozen=True, slots=True, eq=False)
class PathSamples:
    """N decisions: the frames to look at (N x 3, newest first) and the value of each answer.

    `asked` is N x 2, the settings asked for last, scaled as `settings` are.
    """

    frames: Tensor
    settings: Tensor
    newest_first: Tensor
    asked: Tensor
    values: Tensor

    def __len__(self) -> int:
        return len(self.newest_first)

    def to(self, device: torch.device) -> PathSamples:
        """Return the same samples on a device."""
        return PathSamples(
            self.frames.to(device),
            self.settings.to(device),
            self.newest_first.to(device),
            self.asked.to(device),
            self.values.to(device),
        )

    def batch(self, chosen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return images N x 6 x 48 x 64, settings N x 8 and values N x S."""
        rows = self.newest_first[chosen]
        images = self.frames[rows].flatten(1, 2).float() / 255
        settings = torch.cat([self.settings[rows].flatten(1), self.asked[chosen]], 1)
        return images, settings, self.values[chosen]


@dataclass(frozen=True, slots=True, eq=False)
class _Lesson:
    """What a drive teaches in one light, for each of P-1 pairs.

    `matched` is what the matches of each move are worth, S x S; `stays` what the other front end
    gets where a setting stays, S; `following` what is worth having reached a setting, S.
    """

    matched: Values
    stays: Staying
    following: Values


class Lessons:
    """What moves are worth in some drives, in any light; worked out when first asked for."""

    def __init__(self, drives: Sequence[SeenDrive], grid: SettingsGrid, utility: Utility) -> None:
        self._drives, self._grid, self._utility = drives, grid, utility
        self._known: dict[tuple[int, int], _Lesson] = {}

    def of(self, journey: Journey) -> NDArray[np.float32]:
        """Return decisions x S values: what each answer is worth to the frame that it reaches.

        Nobody knows that the light will change: in the lesson it stays as it is at the decision.
        The move begins at what was asked for last, which is used by then. Between cells its matches
        are a mixture; the change of brightness, which the other front end suffers from, is exact.
        """
        late = journey.trip.latency
        asked = journey.used[late:-1]
        light = journey.trip.light_at(np.arange(len(asked)))
        values = np.empty((len(asked), len(self._grid)), np.float32)
        for steps in np.unique(light):
            now = np.flatnonzero(light == steps)
            lesson = self._lesson(journey.trip.drive, int(steps))
            values[now] = self._values(lesson, now + late, asked[now])
        return values

    def _values(
        self, lesson: _Lesson, pairs: NDArray[np.int64], asked: NDArray[np.float64]
    ) -> Values:
        """Return N x S values of moves from N settings, each at a pair of its own."""
        cells, corners = self._grid.corners(asked)
        weights = corners.astype(np.float32)
        rows = pairs[:, None], cells
        matched = np.einsum("nc,ncs->ns", weights, lesson.matched[rows])
        stays = lesson.stays
        before = Staying(*((weights * of[rows]).sum(1) for of in (stays.inliers, stays.told)))
        after = Staying(stays.inliers[pairs], stays.told[pairs])
        besides = change_worth(before, after, asked, self._utility, self._grid)
        return np.asarray(matched + besides + lesson.following[pairs])

    def _lesson(self, drive: int, light: int) -> _Lesson:
        """Return what a drive teaches where all light is `light` steps brighter."""
        if (drive, light) not in self._known:
            like = self._grid.relit(light)
            seen, utility = self._drives[drive], self._utility
            matched = utility.of(denoised(seen.moves[:, like][:, :, like]))
            stays = staying(seen.steady[:, like], seen.told[:, like])
            worth = move_worth(matched, stays, utility, self._grid)
            values = move_values(worth, utility.discount)
            reached = np.concatenate([values[1:].max(2), np.zeros_like(values[:1, 0])])
            following = np.float32(utility.discount) * reached
            self._known[drive, light] = _Lesson(matched, stays, following)
        return self._known[drive, light]


def gather(journeys: Sequence[Journey], lessons: Lessons) -> PathSamples:
    """Return the decisions of journeys; those whose effect lies behind the end are left out."""
    rows, asked, answers, start = [], [], [], 0
    for journey in journeys:
        answers.append(lessons.of(journey))
        pose = np.arange(len(answers[-1]))
        rows.append(start + np.stack([np.maximum(pose - back, 0) for back in range(FRAMES)], 1))
        asked.append(journey.used[pose + journey.trip.latency])
        start += len(journey.used)
    used, last = np.concatenate([journey.used for journey in journeys]), np.concatenate(asked)
    return PathSamples(
        frames=torch.from_numpy(np.concatenate([journey.frames for journey in journeys])),
        settings=torch.from_numpy(scale_settings(used[:, 0], used[:, 1])),
        newest_first=torch.from_numpy(np.concatenate(rows)),
        asked=torch.from_numpy(scale_settings(last[:, 0], last[:, 1])),
        values=torch.from_numpy(np.concatenate(answers)),
    )
