"""What the frames of one exposure and gain say together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.types import Frame
from rig.core.units import gain_factor

PATCH_PX = 16

_LEAST_NOISE_DN = 0.65
_SIGMAS_FROM_ENDS = 3.0

Mosaic = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """Several frames of one setting: mean and temporal noise of a pixel, both in DN of 8 bits.

    `flicker` is the standard deviation of the frames' means over their mean. `patch` is a part of
    the first frame, PATCH_PX square.
    """

    exposure_us: float
    gain_db: float
    mean_dn: float
    noise_dn: float
    flicker: float
    patch: Mosaic

    @property
    def light_us(self) -> float:
        """Return the exposure times the stated gain: what the converter sees, up to a factor."""
        return self.exposure_us * gain_factor(self.gain_db)


def summarise_step(frames: Sequence[Frame]) -> Step:
    """Return what at least two frames of one setting say.

    Noise as EMVA 1288 takes it: over time, pixel by pixel, so neither the fixed pattern nor an
    uneven surface is in it; what all pixels do together (flicker) is taken out as well.
    """
    stack = np.stack([centre(frame) for frame in frames]).astype(np.float32)
    means = stack.mean((1, 2), dtype=np.float64)
    still = stack - means[:, None, None].astype(np.float32)
    used = frames[0].used
    mean = float(means.mean())
    return Step(
        exposure_us=used.exposure_us,
        gain_db=used.gain_db,
        mean_dn=mean,
        noise_dn=float(np.sqrt(still.var(0, ddof=1).mean(dtype=np.float64))),
        flicker=float(means.std(ddof=1)) / max(mean, 1.0),
        patch=np.ascontiguousarray(centre(frames[0])[:PATCH_PX, :PATCH_PX]),
    )


def highest_dn(steps: Sequence[Step]) -> float:
    """Return the grey value that no light exceeds, at the lowest gain."""
    lowest_db = min(step.gain_db for step in steps)
    return max(step.mean_dn for step in steps if step.gain_db == lowest_db)


def measurable(steps: Sequence[Step]) -> list[Step]:
    """Return the steps whose mean and noise are those of the light.

    That needs noise enough to bridge the steps of 8 bits, at whose edges two values alone come to
    a noise of 0.5 DN, and nothing cut off at black or white.
    """
    top_dn = highest_dn(steps)
    return [step for step in steps if _is_measurable(step, top_dn)]


def _is_measurable(step: Step, top_dn: float) -> bool:
    reach_dn = _SIGMAS_FROM_ENDS * step.noise_dn
    inside = step.mean_dn - reach_dn > -0.5 and step.mean_dn + reach_dn < top_dn
    return inside and step.noise_dn >= _LEAST_NOISE_DN


def centre(frame: Frame) -> Mosaic:
    """Return the pixels that are measured: the middle of the picture, of a mosaic the green ones.

    The middle half each way, where a lens lets about the same light through.
    """
    height, width = frame.image.shape
    top, left = height // 8 * 2, width // 8 * 2
    middle = frame.image[top : height - top, left : width - left]
    if frame.pixel_format == "mono8":
        return middle
    return np.concatenate([middle[0::2, 1::2], middle[1::2, 0::2]])
