"""What stands around a building: ground, trees, and the houses across."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from rig.drivers.scenes.geometry import Material
from rig.drivers.scenes.rooms import Box, Builder

_REACH_M = 70.0
_KEEP_OFF_M = 3.0
_GRASS = Material("grass", (2.6, 2.6), (0.75, 1.2, 0.4), 0.05)
_GRAVEL = Material("gravel", (1.6, 1.6), (1.05, 1.0, 0.9), 0.05)


def surroundings(build: Builder, house: Box) -> None:
    """Put the ground, a gravel strip, some trees and houses around a building."""
    rng = build.rng
    edges = np.linspace(-_REACH_M, _REACH_M, 15)
    middle_x, middle_z = (house.left_m + house.right_m) / 2, (house.near_m + house.far_m) / 2
    for x0, x1 in pairwise(edges):
        for z0, z1 in pairwise(edges):
            build.put.quad(
                [np.array([x + middle_x, -0.06, z + middle_z])
                 for x, z in ((x0, z0), (x1, z0), (x1, z1), (x0, z1))],
                np.array([0.0, 1.0, 0.0]), _GRASS, 0.4,
                at_tile=(float(x0) / 2.6, float(z0) / 2.6),
            )  # fmt: skip
    path = 2.5
    along = (house.near_m - path, house.far_m + path)
    for across in ((house.left_m - path, house.left_m), (house.right_m, house.right_m + path)):
        build.block(across, (-0.2, -0.03), along, _GRAVEL, texels_per_m=1.0)
    for k in range(14):
        angle = 2 * np.pi * (k + rng.uniform(-0.3, 0.3)) / 14
        away = float(rng.uniform(7.0, 16.0))
        x, z = middle_x + away * np.sin(angle), middle_z + away * 1.4 * np.cos(angle)
        if _off(house, float(x), float(z)) and rng.random() < 0.7:
            build.tree(float(x), float(z), float(rng.uniform(3.5, 8.0)))
    for k in range(9):
        angle = 2 * np.pi * (k + rng.uniform(-0.2, 0.2)) / 9
        away = float(rng.uniform(32.0, 50.0))
        x, z = middle_x + away * np.sin(angle), middle_z + away * np.cos(angle)
        wide, deep = (float(v) for v in rng.uniform(5.0, 9.0, 2))
        tile = (float(rng.uniform(7.0, 10.0)), float(rng.uniform(6.0, 9.0)))
        front = Material(f"facade{rng.integers(4)}", tile, build.shade(), 0.08)
        up = (-0.1, float(rng.uniform(5.0, 13.0)))
        build.block((x - wide, x + wide), up, (z - deep, z + deep), front, texels_per_m=0.8)


def _off(house: Box, x: float, z: float) -> bool:
    """Return whether a place keeps off the building."""
    return not (
        house.left_m - _KEEP_OFF_M < x < house.right_m + _KEEP_OFF_M
        and house.near_m - _KEEP_OFF_M < z < house.far_m + _KEEP_OFF_M
    )
