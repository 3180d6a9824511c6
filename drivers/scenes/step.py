"""A scene whose light changes at once: how long does a controller take to follow?"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics, Side, Truth
from rig.drivers.scenes.scene import Scene, View


@dataclass(frozen=True, slots=True)
class LightStep:
    """`factor` times the light from trigger `pair` on."""

    factor: float
    pair: int

    def __str__(self) -> str:
        """Return the step as it is written in an address."""
        return f"{self.factor:g}@{self.pair}"


def read_light_step(word: str) -> LightStep:
    """Return the step that `10@30` names; raises ValueError with what it must be."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)@(\d+)", word)
    if not found or float(found[1]) == 0:
        raise ValueError("a factor above 0 and a pair, such as 10@30")
    return LightStep(float(found[1]), int(found[2]))


@dataclass(frozen=True, slots=True, eq=False)
class LitView:
    """A view in `factor` times the light."""

    view: View
    factor: np.float32

    @property
    def radiance_cd_m2(self) -> NDArray[np.float32]:
        """Return the radiance, H x W, cd/m2."""
        return self.view.radiance_cd_m2 * self.factor

    @property
    def depth_m(self) -> NDArray[np.float32]:
        """Return the distance along the optical axis, H x W, metres."""
        return self.view.depth_m

    def exposed(self, exposure_us: float) -> NDArray[np.float32]:
        """Return the mean radiance over an exposure that starts now, H x W, cd/m2."""
        return self.view.exposed(exposure_us) * self.factor


@dataclass(frozen=True, slots=True, eq=False)
class SteppedScene:
    """A scene with `factor` times the light from `from_s` seconds on."""

    scene: Scene
    factor: float
    from_s: float

    @property
    def world_version(self) -> str:
        """Return the version of the world."""
        return self.scene.world_version

    @property
    def drive_s(self) -> float:
        """Return how long the drive takes, seconds."""
        return self.scene.drive_s

    def intrinsics(self, side: Side) -> Intrinsics:
        """Return the pinhole intrinsics of one camera."""
        return self.scene.intrinsics(side)

    def view(self, side: Side, time_s: float) -> View:
        """Return what one camera sees `time_s` seconds after the start of the drive."""
        view = self.scene.view(side, time_s)
        return LitView(view, np.float32(self.factor)) if self._stepped(time_s) else view

    def truth(self, time_s: float) -> Truth:
        """Return where the primary camera is and how bright its view is."""
        truth = self.scene.truth(time_s)
        if not self._stepped(time_s):
            return truth
        return replace(truth, light_cd_m2=truth.light_cd_m2 * self.factor)

    def _stepped(self, time_s: float) -> bool:
        return time_s >= self.from_s - 1e-6
