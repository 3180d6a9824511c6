"""The score-map network: three thumbnails and their settings in, the next settings out.

Inside, it scores every cell of a settings grid and answers with the mean of the cells around the
best one, weighted by their probability: a peaked or a two-peaked map never gives the dead middle
between two good settings, as a regression would. Everything from the thumbnails on is inside the
graph, so whoever runs it needs to know nothing about grids.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from rig.core.types import THESIS_LIMITS, Limits
from rig.models.scoremap.grid import SettingsGrid
from rig.vision.thumbnail import THUMBNAIL_PX

FRAMES = 3
SHOWN_CHANNELS = 2
"""Per frame of the input: brightness and saturation."""

TOLD = 2 * (FRAMES + 1)
"""Inputs besides pictures: exposure and gain of each frame, then those asked for last."""

_CHANNELS_A_FRAME = 3
_GAMMA = 2.2
_DARKEST = 0.02
_RADIANCE_RANGE_EV = 6.0
_EV_PER_DB = float(1 / (20 * np.log10(2)))
_DROPOUT = 0.2


class ScoreMapNetwork(nn.Module):
    """Three strided convolutions and three full layers; `forward` gives 0..1 of the limits.

    `images` is float32 N x 6 x 48 x 64 in 0..1, (brightness, saturation) of t, t-1, t-2; `settings`
    float32 N x 8, (exposure, gain) of the same frames and of what was asked for last, in 0..1 of
    the limits (thesis eq. 4.14). A late camera has not used the latter yet, and the answer follows
    it. `smoothing` in [0, 1) is its share, in logarithms, in the answer;
    `width` multiplies the channels of all layers.
    """

    cells: Tensor
    near: Tensor

    def __init__(
        self,
        grid: SettingsGrid,
        limits: Limits = THESIS_LIMITS,
        smoothing: float = 0.0,
        width: int = 1,
    ) -> None:
        super().__init__()
        self.limits, self.smoothing = limits, smoothing
        self.register_buffer("cells", torch.from_numpy(_cells(grid, limits)), persistent=False)
        self.register_buffer("near", torch.from_numpy(_near(grid)), persistent=False)
        columns, rows = THUMBNAIL_PX
        narrow, wide = 32 * width, 64 * width
        self.first = nn.Conv2d(_CHANNELS_A_FRAME * FRAMES, narrow, 4, 4)
        self.offset = nn.Linear(TOLD, narrow, bias=False)
        self.stages = nn.Sequential(
            nn.BatchNorm2d(narrow),
            nn.ReLU(),
            *_stage(narrow, wide),
            *_stage(wide, wide),
            nn.Dropout(_DROPOUT),
        )
        features = wide * (columns // 16) * (rows // 16) + TOLD
        self.head = nn.Sequential(
            nn.Linear(features, 2 * wide),
            nn.BatchNorm1d(2 * wide),
            nn.ReLU(),
            nn.Dropout(_DROPOUT),
            nn.Linear(2 * wide, wide),
            nn.ReLU(),
            nn.Linear(wide, len(grid)),
        )

    def forward(self, images: Tensor, settings: Tensor) -> Tensor:
        """Return the next (exposure, gain), N x 2, in 0..1 of the limits."""
        return self.decode(self.scores(images, settings), settings)

    def scores(self, images: Tensor, settings: Tensor) -> Tensor:
        """Return the score of every cell of the grid, N x S."""
        logarithmic = self.logarithmic(settings)
        stops = self._stops(logarithmic)
        shown = images.reshape(-1, FRAMES, SHOWN_CHANNELS, *images.shape[2:])
        light = torch.log2(shown[:, :, 0].clamp(min=_DARKEST)) * _GAMMA
        radiance = (light - stops[:, :, None, None]) / _RADIANCE_RANGE_EV + 2.0
        channels = torch.cat([shown.flatten(1, 2), radiance], 1)
        offset = self.offset(logarithmic)
        features = self.stages(self.first(channels) + offset[:, :, None, None]).flatten(1)
        scored: Tensor = self.head(torch.cat([features, logarithmic], 1))
        return scored

    def decode(self, scores: Tensor, settings: Tensor) -> Tensor:
        """Return the settings that a score map stands for."""
        probability = torch.softmax(scores, 1)
        around = probability @ self.near
        best = (around == around.amax(1, keepdim=True)).to(probability.dtype)
        weights = probability * (best @ self.near).clamp(max=1.0)
        chosen = (weights / weights.sum(1, keepdim=True)) @ self.cells
        if self.smoothing:
            before = self.logarithmic(settings)[:, 2 * FRAMES :]
            chosen = (1 - self.smoothing) * chosen + self.smoothing * before
        low, high = self.limits.exposure_us
        exposure = (low * torch.exp(chosen[:, :1] * float(np.log(high / low))) - low) / (high - low)
        return torch.cat([exposure, chosen[:, 1:]], 1)

    def logarithmic(self, settings: Tensor) -> Tensor:
        """Return N x 8 settings with each exposure in 0..1 of the limits' logarithms."""
        low, high = self.limits.exposure_us
        pairs = settings.reshape(-1, FRAMES + 1, 2)
        exposure = torch.log(1 + pairs[:, :, :1] * (high / low - 1)) / float(np.log(high / low))
        return torch.cat([exposure, pairs[:, :, 1:]], 2).flatten(1)

    def _stops(self, logarithmic: Tensor) -> Tensor:
        """Return the brightness of each frame's settings in stops above the least."""
        pairs = logarithmic[:, : 2 * FRAMES].reshape(-1, FRAMES, 2)
        low_db, high_db = self.limits.gain_db
        span_ev = float(np.log2(self.limits.exposure_us[1] / self.limits.exposure_us[0]))
        stops: Tensor = pairs[:, :, 0] * span_ev + pairs[:, :, 1] * (high_db - low_db) * _EV_PER_DB
        return stops


class ScoreMapEnsemble(nn.Module):
    """Several score-map networks over one grid that answer together: their probabilities' mean."""

    def __init__(self, members: Sequence[ScoreMapNetwork]) -> None:
        super().__init__()
        self.first, self.others = members[0], nn.ModuleList(members[1:])

    def forward(self, images: Tensor, settings: Tensor) -> Tensor:
        """Return the next (exposure, gain), N x 2, in 0..1 of the limits."""
        return self.first.decode(self.scores(images, settings), settings)

    def scores(self, images: Tensor, settings: Tensor) -> Tensor:
        """Return the logarithm of the mean probability of every cell of the grid, N x S."""
        members: list[Any] = [self.first, *self.others]
        shares = [torch.softmax(one.scores(images, settings), 1) for one in members]
        return torch.log(torch.stack(shares).mean(0))


ScoreMap = ScoreMapNetwork | ScoreMapEnsemble


def _stage(inputs: int, outputs: int) -> tuple[nn.Module, ...]:
    return nn.Conv2d(inputs, outputs, 3, 2, 1), nn.BatchNorm2d(outputs), nn.ReLU()


def _cells(grid: SettingsGrid, limits: Limits) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Return S x (log exposure, gain), each in 0..1 of the limits."""
    cells = grid.cells()
    low, high = limits.exposure_us
    low_db, high_db = limits.gain_db
    exposure = np.log(cells[:, 0] / low) / np.log(high / low)
    gain = (cells[:, 1] - low_db) / (high_db - low_db)
    return np.stack([exposure, gain], axis=1).astype(np.float32)


def _near(grid: SettingsGrid) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Return S x S, 1 where two cells are neighbours or the same."""
    rows, columns = np.divmod(np.arange(len(grid)), grid.shape[1])
    near = (abs(rows[:, None] - rows) <= 1) & (abs(columns[:, None] - columns) <= 1)
    return np.asarray(near, np.float32)
