"""What a simulated camera looks at: the seam between the worlds and the sensor."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from rig.core.types import Intrinsics, Side, Truth

FAR_M = 2000.0
"""The depth of the sky."""


class View(Protocol):
    """The light that falls on one camera at one instant."""

    @property
    def radiance_cd_m2(self) -> NDArray[np.float32]:
        """Return the radiance, H x W, cd/m2, each pixel in its own Bayer channel (RGGB)."""
        ...

    @property
    def depth_m(self) -> NDArray[np.float32]:
        """Return the distance along the optical axis, H x W, metres; FAR_M in the sky."""
        ...

    def exposed(self, exposure_us: float) -> NDArray[np.float32]:
        """Return the mean radiance over an exposure that starts now, H x W, cd/m2."""
        ...


class Scene(Protocol):
    """A world, a drive through it and two cameras on the vehicle."""

    @property
    def world_version(self) -> str:
        """Return the name and number of what makes the radiances, such as `tunnel/6`."""
        ...

    @property
    def drive_s(self) -> float:
        """Return how long the drive takes, seconds."""
        ...

    def intrinsics(self, side: Side) -> Intrinsics:
        """Return the pinhole intrinsics of one camera."""
        ...

    def view(self, side: Side, time_s: float) -> View:
        """Return what one camera sees `time_s` seconds after the start of the drive."""
        ...

    def truth(self, time_s: float) -> Truth:
        """Return where the primary camera is and how bright its view is."""
        ...


@runtime_checkable
class DrivenScene(Scene, Protocol):
    """A scene with ground under the vehicle, whose views are known in grey as well."""

    def grey_cd_m2(self, side: Side, time_s: float) -> NDArray[np.float32]:
        """Return the radiance of a view over all channels: R/4 + G/2 + B/4, H x W, cd/m2."""
        ...

    def ground_lux(self, time_s: float) -> float:
        """Return the illuminance of the ground under the primary camera."""
        ...
