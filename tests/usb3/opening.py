"""USB3 Vision cameras opened by our driver, for tests; whatever is opened is closed again."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count

import pytest
from plane_scene import PlaneScene
from served_pair import aravis_is_here, once, plane_surroundings

from rig.core.clock import VirtualClock
from rig.drivers.aravis.session import PairSpec
from rig.drivers.aravis.source import AravisSource, open_pair
from rig.drivers.simulated.gige.server import PairPlan
from usb3 import bus
from usb3.pair import FIRST_LABEL, UsbPair, reach_in_step

LATER_NS = 60_000_000_000
"""Where virtual time begins, so that a camera's clock that is behind is not below zero."""

_LABELS = count(FIRST_LABEL + 2, 2)

needs_usb = pytest.mark.skipif(
    not (bus.is_loaded() and aravis_is_here()), reason=f"{bus.CANNOT_BUILD}, and Aravis"
)


@contextmanager
def plugged(plan: PairPlan) -> Iterator[UsbPair]:
    """Plug a pair in that lives on a virtual clock."""
    pair = UsbPair(plan, VirtualClock(LATER_NS))
    try:
        yield pair
    finally:
        pair.close()


def open_in_step(plan: PairPlan, scene: PlaneScene) -> AravisSource:
    """Plug a pair of its own in and open it; closing the source pulls it out again."""
    pair = UsbPair(plan, VirtualClock(LATER_NS), next(_LABELS))
    try:
        surroundings = plane_surroundings("usb:plane", scene)
        return open_pair(PairSpec(pair.labels), surroundings, once(pair.close), reach_in_step(pair))
    except BaseException:
        pair.close()
        raise
