"""The smallest scene with something to see: a striped plane in front of two cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics, Side, Truth

WIDTH_PX, HEIGHT_PX = 64, 48


@dataclass(frozen=True)
class PlaneView:
    """A striped plane at 4 m, shifted by the camera's position."""

    shift_px: float

    @property
    def radiance_cd_m2(self) -> NDArray[np.float32]:
        columns = np.arange(WIDTH_PX) + self.shift_px
        stripes = 300 + 200 * np.sin(columns / 3)
        return np.tile(stripes, (HEIGHT_PX, 1)).astype(np.float32)

    @property
    def depth_m(self) -> NDArray[np.float32]:
        return np.full((HEIGHT_PX, WIDTH_PX), 4.0, np.float32)

    def exposed(self, exposure_us: float) -> NDArray[np.float32]:
        return self.radiance_cd_m2


@dataclass(frozen=True)
class PlaneScene:
    """A plane that passes sideways; with `speed_px_s` 0 it stands still."""

    speed_px_s: float
    baseline_px: float = 2.0
    world_version: str = "plane/1"
    drive_s: float = 3.0

    def intrinsics(self, side: Side) -> Intrinsics:
        return Intrinsics(WIDTH_PX, HEIGHT_PX, 56.0, 56.0, 31.5, 23.5)

    def view(self, side: Side, time_s: float) -> PlaneView:
        place_px = self.baseline_px if side == "secondary" else 0.0
        return PlaneView(self.speed_px_s * time_s + place_px)

    def truth(self, time_s: float) -> Truth:
        light = float(self.view("primary", time_s).radiance_cd_m2.mean())
        return Truth((self.speed_px_s * time_s, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), light)
