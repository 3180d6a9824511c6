"""Measure how fast the simulation makes light: baking, rendering, motion blur.

python tools/bench_simulation.py [WIDTHxHEIGHT ...]
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from statistics import median

import numba

from rig.drivers.scenes.scene import Scene
from rig.drivers.scenes.worlds import open_world

SIZES = ("320x240", "640x480", "1024x768", "2048x1536")
EXPOSURES_US = (1_000.0, 5_000.0, 30_000.0)


def main() -> None:
    print(f"{numba.get_num_threads()} threads")
    with tempfile.TemporaryDirectory() as cache:
        os.environ["RIG_CACHE_DIR"] = cache
        print(f"open, light to bake: {seconds(lambda: world('64x48')):6.2f} s (with compilation)")
        print(f"open, light to bake: {seconds(lambda: world('64x48', seed=1)):6.2f} s")
        print(f"open, light in cache: {seconds(lambda: world('64x48')):5.2f} s")
        for size in sys.argv[1:] or SIZES:
            measure(size)


def measure(size: str) -> None:
    scene = world(size)
    scene.view("primary", 0.05).exposed(1_000.0)
    times = [seconds(lambda t=t: scene.view("primary", t)) for t in range(12)]
    line = [f"{size:>10}: view {1e3 * median(times):6.1f} ms"]
    view = scene.view("primary", 3.0)
    for exposure_us in EXPOSURES_US:
        blur = median(seconds(lambda e=exposure_us: view.exposed(e)) for _ in range(5))
        line.append(f"blur {exposure_us / 1e3:g} ms: {1e3 * blur:6.1f} ms")
    print(", ".join(line))


def world(size: str, seed: int = 0) -> Scene:
    width_px, height_px = (int(side) for side in size.split("x"))
    return open_world(
        "tunnel", seed=seed, split="test", width_px=width_px, height_px=height_px, speed_mps=13.9
    )


def seconds(act: Callable[[], object]) -> float:
    start = time.perf_counter()
    act()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
