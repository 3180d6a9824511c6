"""Scores of one picture, by which exposure methods of the literature judge it.

All look at 8-bit pictures: grey H x W, or colour H x W x 3 in OpenCV's B, G, R order. The scores
of `score` look at every pixel; controllers look at a `sample`.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.vision.metrics.features import FeatureScore, features
from rig.vision.metrics.gradient import gradient_sum, sampled_information, shim_gradient
from rig.vision.metrics.kim import kim
from rig.vision.metrics.sampling import Places, Sample, sample
from rig.vision.metrics.shin import SHIN_VARIANTS, ShinScore, shin, shin_at
from rig.vision.metrics.tone import entropy_bits, geometric_mean_dn, mean_dn
from rig.vision.metrics.zhang import zhang_percentile, zhang_soft

__all__ = [
    "SHIN_VARIANTS",
    "FeatureScore",
    "Places",
    "Sample",
    "ShinScore",
    "entropy_bits",
    "features",
    "geometric_mean_dn",
    "gradient_sum",
    "kim",
    "mean_dn",
    "sample",
    "sampled_information",
    "score",
    "shim_gradient",
    "shin",
    "shin_at",
    "zhang_percentile",
    "zhang_soft",
]


def score(bgr: NDArray[np.uint8]) -> dict[str, float]:
    """Return every score of a colour picture, at full size, under the names of `rig metrics`.

    Raises ValueError for a picture under 10 x 10 pixels.
    """
    grey = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), np.uint8)
    found = features(grey)
    return {
        "entropy": entropy_bits(grey),
        "shim-gradient": shim_gradient(grey),
        "gradient-sum": gradient_sum(grey),
        "zhang-percentile": zhang_percentile(grey),
        "zhang-soft": zhang_soft(grey),
        "kim": kim(grey),
        **{f"shin-{variant}": shin(bgr, variant).score for variant in SHIN_VARIANTS},
        "features": found.count,
        "uniformity": found.uniformity,
    }
