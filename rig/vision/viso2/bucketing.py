"""A few matches everywhere instead of many in places."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BUCKET_PX = 50
MATCHES_A_BUCKET = 2


def bucketed(current_px: NDArray[np.int32], seed: int) -> NDArray[np.int64]:
    """Return the rows of at most 2 matches, drawn at random, in every 50 x 50 px of the picture.

    `current_px` is N x 2. Rows come in order of their buckets; the same seed draws the same.
    """
    if len(current_px) == 0:
        return np.empty(0, np.int64)
    cells = current_px.astype(np.int64) // BUCKET_PX
    bucket = cells[:, 1] * (cells[:, 0].max() + 1) + cells[:, 0]
    order = np.lexsort((np.random.default_rng(seed).random(len(bucket)), bucket))
    in_order = bucket[order]
    first = np.searchsorted(in_order, in_order)
    return np.asarray(order[np.arange(len(order)) - first < MATCHES_A_BUCKET])
