"""What streets are made of: the materials of roads, houses and underpasses."""

from __future__ import annotations

from dataclasses import dataclass

from rig.drivers.scenes.geometry import Material

ASPHALT = Material("asphalt", (5.0, 5.0), (1.0, 0.98, 0.95), 0.11)
CONCRETE = Material("concrete", (8.0, 8.0), (1.0, 0.97, 0.9), 0.13)
LIGHT_CONCRETE = Material("pavers", (3.0, 3.0), (1.95, 1.9, 1.8), 0.17)
SLABS = Material("pavers", (4.8, 4.8), (1.25, 1.22, 1.15), 0.06)
GREY_PAVERS = Material("pavers", (3.0, 3.0), (1.27, 1.23, 1.16), 0.06)
PAVERS = Material("pavers", (2.4, 2.4), (1.0, 0.96, 0.9), 0.17)
BRICK = Material("brick", (1.6, 1.6), (1.35, 0.85, 0.65), 0.09)
PLASTER = Material("brick", (1.6, 1.6), (1.9, 1.8, 1.6), 0.09)
WHITE = Material("pavers", (4.8, 3.6), (1.8, 1.77, 1.7), 0.05)
BRIGHT = Material("pavers", (4.8, 3.6), (2.5, 2.45, 2.35), 0.05)
GRASS = Material("grass", (2.6, 2.6), (0.8, 1.15, 0.4), 0.07)
PAINT = Material("paint", (1.0, 1.0), (1.0, 1.0, 1.0), 0.3)
WORN_PAINT = Material("paint", (1.0, 1.0), (0.6, 0.6, 0.6), 0.3)
METAL = Material("metal", (2.0, 2.0), (1.0, 1.0, 1.0), 0.2)
DARK = Material("dark", (1.5, 1.5))
LAMP = Material("blank", (1.0, 1.0), (1.1, 1.0, 0.8))
FOLIAGE = Material("foliage", None, (0.75, 1.15, 0.4))


@dataclass(frozen=True, slots=True)
class Ground:
    """What a stretch of road and its borders are made of.

    `verge` None ends at a wall, `kerb` None makes all of it level.
    """

    road: Material
    pavement: Material
    kerb: Material | None
    paint: Material
    verge: Material | None


STREET = Ground(ASPHALT, PAVERS, CONCRETE, PAINT, GRASS)
SQUARE = Ground(SLABS, GREY_PAVERS, None, PAINT, GREY_PAVERS)
TUBE = Ground(ASPHALT, PAVERS, CONCRETE, WORN_PAINT, None)
