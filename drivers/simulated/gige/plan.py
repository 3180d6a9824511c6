"""A simulated source as something to serve."""

from __future__ import annotations

from rig.core.types import SIDES, Pair
from rig.drivers.simulated.gige.server import PairPlan
from rig.drivers.simulated.source import SimulatedSource, photographer


def plan_of(source: SimulatedSource) -> PairPlan:
    """Return the plan that shows a client what `source` shows in process, picture by picture."""
    drive, size = source.drive, source.intrinsics.primary
    return PairPlan(
        model=drive.model,
        width_px=size.width_px,
        height_px=size.height_px,
        take_picture=Pair(*(photographer(source.scene, side, drive) for side in SIDES)),
        latency_frames=drive.latency_frames,
    )
