"""A simulated pair behind GigE Vision, served from a thread, for tests that open it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
from plane_scene import HEIGHT_PX, WIDTH_PX, PlaneScene

from rig.config import load_camera_model
from rig.core.errors import CameraError
from rig.core.types import SIDES, Pair
from rig.drivers.aravis.binding import library
from rig.drivers.aravis.session import PairSpec
from rig.drivers.aravis.source import AravisSource, Surroundings, open_pair
from rig.drivers.simulated.gige.server import PairPlan, Server
from rig.drivers.simulated.source import Drive, photographer

MODEL = load_camera_model("blackfly-s-u3-31s4")


def aravis_is_here() -> bool:
    try:
        library()
    except CameraError:
        return False
    return True


needs_aravis = pytest.mark.skipif(not aravis_is_here(), reason="Aravis is not installed")


def plane_plan(seed: int = 0, speed_px_s: float = 0.0, **changes: object) -> PairPlan:
    """Return a plan that shows the striped plane."""
    scene, drive = PlaneScene(speed_px_s), Drive(MODEL, noise_seed=seed)
    pictures = Pair(*(photographer(scene, side, drive) for side in SIDES))
    return replace(PairPlan(MODEL, WIDTH_PX, HEIGHT_PX, pictures), **changes)


class RunningServer:
    """A server in a thread of its own."""

    def __init__(self, plan: PairPlan) -> None:
        self.server = Server(plan)
        self._going = True
        self._thread = threading.Thread(target=self.server.run, args=(lambda: self._going,))
        self._thread.start()

    def close(self) -> None:
        self._going = False
        self._thread.join()
        self.server.close()


@contextmanager
def served(plan: PairPlan) -> Iterator[Server]:
    """Serve a plan while the block runs."""
    running = RunningServer(plan)
    try:
        yield running.server
    finally:
        running.close()


def open_served(plan: PairPlan, scene: PlaneScene) -> AravisSource:
    """Serve a plan and open it through Aravis; closing the source ends the server."""
    running = RunningServer(plan)
    return open_running(running, scene)


def open_running(running: RunningServer, scene: PlaneScene) -> AravisSource:
    try:
        surroundings = plane_surroundings("gige:sim:plane", scene)
        return open_pair(PairSpec(running.server.addresses), surroundings, once(running.close))
    except BaseException:
        running.close()
        raise


def plane_surroundings(address: str, scene: PlaneScene) -> Surroundings:
    """Return what a run over the plane knows beside its cameras."""
    return Surroundings(
        address,
        Pair(*(scene.intrinsics(side) for side in SIDES)),
        drive_triggers=30,
        world_version=scene.world_version,
        truth=lambda trigger: scene.truth(trigger / 10.0),
    )


def once(close: object) -> object:
    """Return a function that closes at its first call only."""
    left = [close]

    def closing() -> None:
        while left:
            left.pop()()

    return closing
