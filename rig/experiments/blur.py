"""How well blur by depth flow agrees with exact sub-exposures, in light and in what it is for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rig.config import load_camera_model
from rig.core.types import Settings
from rig.drivers.scenes.world import RenderedScene
from rig.drivers.sensor.sensor import Sensor
from rig.vision.bayer import to_grey
from rig.vision.orb import OrbFeatures, OrbFrontEnd

MOMENTS_PER_MS = 2.0
_LEAST_MOMENTS = 12
_RATE_HZ = 10.0
_EXPOSED_TO = 0.8


@dataclass(frozen=True, slots=True)
class BlurAgreement:
    """`log_error` is the median of |ln(flow / exact)| over all pixels; inliers are means."""

    log_error: float
    inliers_exact: float
    inliers_flow: float

    @property
    def inlier_error(self) -> float:
        """Return by how much the inliers of flow blur differ, as a share of the exact ones."""
        return abs(self.inliers_flow / self.inliers_exact - 1.0)


def blur_agreement(
    scene: RenderedScene, pairs: Sequence[int], exposure_us: float, noises: int = 8
) -> BlurAgreement:
    """Compare both kinds of blur over consecutive pairs of frames, each taken `noises` times.

    Pair k is frames k and k + 1 at 10 Hz; `pairs` are consecutive. Both kinds get the same sensor
    noise. The light is scaled so that the median pixel comes to 80 % of the well: as much light
    as this exposure is right for.
    """
    frames = list(range(pairs[0], pairs[-1] + 2))
    exact, flow = [], []
    for frame in frames:
        view = scene.view("primary", frame / _RATE_HZ)
        moments = max(_LEAST_MOMENTS, round(MOMENTS_PER_MS * exposure_us / 1e3))
        exact.append(view.exposed_exactly(exposure_us, moments))
        flow.append(view.exposed(exposure_us))
    errors = [np.median(np.abs(np.log(a / b))) for a, b in zip(flow, exact, strict=True)]
    return BlurAgreement(
        float(np.mean(errors)),
        _inliers(exact, exact, exposure_us, noises),
        _inliers(flow, exact, exposure_us, noises),
    )


def _inliers(
    pictures: Sequence[NDArray[np.float32]],
    standard: Sequence[NDArray[np.float32]],
    exposure_us: float,
    noises: int,
) -> float:
    """Return the mean inliers of neighbouring `pictures`, as bright as the `standard` allows."""
    model = load_camera_model("blackfly-s-u3-31s4")
    sensor = Sensor(model, (standard[0].shape[0], standard[0].shape[1]), seed=0)
    e_per_cd_m2 = sensor.electrons_per_cd_m2_s * exposure_us * 1e-6
    scale = _EXPOSED_TO * model.pixel.full_well_e / (float(np.median(standard)) * e_per_cd_m2)
    front_end = OrbFrontEnd()
    settings = Settings(exposure_us, 0.0)

    def features(k: int, noise: int) -> OrbFeatures:
        light = (pictures[k] * scale).astype(np.float32)
        picture = sensor.develop(light, settings, noise * len(pictures) + k)
        return front_end.features(to_grey(picture, "bayer_rggb8"))

    counts = []
    for noise in range(noises):
        found = [features(k, noise) for k in range(len(pictures))]
        counts += [front_end.match(a, b).inliers for a, b in pairwise(found)]
    return float(np.mean(counts))
