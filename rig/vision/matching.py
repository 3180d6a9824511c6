"""Nearest neighbours among binary descriptors, by population count."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

DESCRIPTOR_BYTES = 32


def mutual_matches(
    descriptors_a: NDArray[np.uint8], descriptors_b: NDArray[np.uint8]
) -> NDArray[np.int64]:
    """Return the pairs (row of a, row of b) that are each other's nearest by Hamming distance.

    N x 32 and M x 32 descriptors give K x 2 indices, in the order of a. Of equally near neighbours
    the first counts: the matches are those of OpenCV's brute-force matcher with cross-check.
    Raises ValueError for another descriptor width.
    """
    for descriptors in (descriptors_a, descriptors_b):
        if descriptors.ndim != 2 or descriptors.shape[1] != DESCRIPTOR_BYTES:
            raise ValueError(f"descriptors must be N x 32 bytes, got shape {descriptors.shape}")
    if len(descriptors_a) == 0 or len(descriptors_b) == 0:
        return np.empty((0, 2), np.int64)
    nearest_b, nearest_a = _nearest(_words(descriptors_a), _words(descriptors_b))
    rows = np.arange(len(descriptors_a))
    mutual = nearest_a[nearest_b] == rows
    return np.stack([rows[mutual], nearest_b[mutual]], axis=1)


def _words(descriptors: NDArray[np.uint8]) -> NDArray[np.uint64]:
    return np.ascontiguousarray(descriptors).view(np.uint64)


def _count_ones(typing_context: Any, word: Any) -> Any:
    """Count the ones of a 64-bit word in one machine instruction."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        count = builder.module.declare_intrinsic("llvm.ctpop", [arguments[0].type])
        return builder.call(count, arguments)

    return types.uint64(types.uint64), generate


_population_count: Any = intrinsic(_count_ones)


@njit(cache=True, nogil=True)
def _nearest(
    a: NDArray[np.uint64], b: NDArray[np.uint64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return for every row of a its nearest row of b, and for every row of b that of a."""
    far: Any = np.uint64(8 * DESCRIPTOR_BYTES + 1)
    nearest_b, nearest_a = np.zeros(len(a), np.int64), np.zeros(len(b), np.int64)
    distance_to_a = np.full(len(b), far)
    for i in range(len(a)):
        distance_to_b = far
        a0, a1, a2, a3 = a[i, 0], a[i, 1], a[i, 2], a[i, 3]
        for j in range(len(b)):
            distance = (
                _population_count(a0 ^ b[j, 0])
                + _population_count(a1 ^ b[j, 1])
                + _population_count(a2 ^ b[j, 2])
                + _population_count(a3 ^ b[j, 3])
            )
            if distance < distance_to_b:
                distance_to_b, nearest_b[i] = distance, j
            if distance < distance_to_a[j]:
                distance_to_a[j], nearest_a[j] = distance, i
    return nearest_b, nearest_a
