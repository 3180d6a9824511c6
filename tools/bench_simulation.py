"""Measure how fast the simulation makes light and pictures, and how much memory it takes.

python tools/bench_simulation.py [WIDTHxHEIGHT ...]

Every time is given twice: as it passed, and as the processors spent it, which other work on the
machine changes less.
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from statistics import median
from typing import NamedTuple

import numba

from rig.config import load_camera_model
from rig.core.types import SIDES, Settings
from rig.drivers.scenes.scene import Scene
from rig.drivers.scenes.worlds import open_world
from rig.drivers.sensor.sensor import Sensor
from rig.drivers.simulated.source import Drive, photographer

SIZES = ("320x240", "640x480", "1024x768", "2048x1536")
EXPOSURES_US = (1_000.0, 5_000.0, 30_000.0)
CAMERA = "blackfly-s-u3-31s4"
PAIRS, ALL_PAIRS = 40, 10_000


class Spent(NamedTuple):
    """Seconds as they passed and of all processors together."""

    passed_s: float
    processor_s: float

    def __str__(self) -> str:
        return f"{1e3 * self.passed_s:6.1f} ms ({1e3 * self.processor_s:.1f} of processors)"


def main() -> None:
    print(f"{numba.get_num_threads()} threads")
    with tempfile.TemporaryDirectory() as cache:
        os.environ["RIG_CACHE_DIR"] = cache
        print(f"open, light to bake: {spent(lambda: world('64x48'))} (with compilation)")
        print(f"open, light to bake: {spent(lambda: world('64x48', seed=1))}")
        print(f"open, light in cache: {spent(lambda: world('64x48'))}")
        for size in sys.argv[1:] or SIZES:
            measure(size)
        measure_pairs("640x480")
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"most memory: {peak_mb:.0f} MB")


def measure(size: str) -> None:
    scene = world(size)
    scene.view("primary", 0.05).exposed(1_000.0)
    print(f"{size:>10}: view {middle([lambda t=t: scene.view('primary', t) for t in range(12)])}")
    view = scene.view("primary", 3.0)
    for exposure_us in EXPOSURES_US:
        blur = middle([lambda e=exposure_us: view.exposed(e)] * 5)
        print(f"{'':>12}blur {exposure_us / 1e3:g} ms: {blur}")
    lens = scene.intrinsics("primary")
    sensor = Sensor(load_camera_model(CAMERA), (lens.height_px, lens.width_px), seed=0)
    light, settings = view.exposed(1_000.0), Settings(1_000.0, 0.0)
    sensor.develop(light, settings, 0)
    print(f"{'':>12}sensor {middle([lambda: sensor.develop(light, settings, 1)] * 15)}")


def measure_pairs(size: str) -> None:
    """Take stereo pairs as a drive does, at 5 ms."""
    scene = world(size)
    drive = Drive(load_camera_model(CAMERA), noise_seed=0)
    cameras = [photographer(scene, side, drive) for side in SIDES]
    for take in cameras:
        take(0, Settings(5_000.0, 0.0))

    def shoot() -> None:
        for trigger in range(1, PAIRS + 1):
            for take in cameras:
                take(trigger, Settings(5_000.0, 0.0))

    found = spent(shoot)
    whole = ALL_PAIRS / PAIRS / 60
    print(
        f"{ALL_PAIRS} pairs at {size}: {whole * found.passed_s:.0f} minutes "
        f"({whole * found.processor_s:.0f} of processors), from {PAIRS} pairs"
    )


def world(size: str, seed: int = 0) -> Scene:
    width_px, height_px = (int(side) for side in size.split("x"))
    return open_world(
        "tunnel", seed=seed, split="test", width_px=width_px, height_px=height_px, speed_mps=13.9
    )


def middle(acts: list[Callable[[], object]]) -> Spent:
    found = [spent(act) for act in acts]
    return Spent(median(f.passed_s for f in found), median(f.processor_s for f in found))


def spent(act: Callable[[], object]) -> Spent:
    passed_s, processor_s = time.perf_counter(), time.process_time()
    act()
    return Spent(time.perf_counter() - passed_s, time.process_time() - processor_s)


if __name__ == "__main__":
    main()
