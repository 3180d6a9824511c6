"""Times the sensor at full size: `.venv/bin/python tools/bench_sensor.py [THREADS]`."""

from __future__ import annotations

import sys
import time

import numba
import numpy as np

from rig.config import load_camera_model
from rig.core.types import Settings
from rig.drivers.sensor.sensor import Sensor

SHAPE = (1536, 2048)
FRAMES = 40
BRIGHTEST_CD_M2 = {"daylight": 3_000.0, "tunnel": 5.0, "lens cap": 0.0}


def main() -> None:
    threads = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    numba.set_num_threads(threads)
    sensor = Sensor(load_camera_model("blackfly-s-u3-31s4"), SHAPE, seed=0)
    rng = np.random.default_rng(0)
    settings = Settings(3_000.0, 0.0)
    for name, brightest_cd_m2 in BRIGHTEST_CD_M2.items():
        light = (brightest_cd_m2 * rng.random(SHAPE)).astype(np.float32)
        sensor.develop(light, settings, 0)
        times_s = []
        for seed in range(FRAMES):
            start_s = time.perf_counter()
            sensor.develop(light, settings, seed)
            times_s.append(time.perf_counter() - start_s)
        best_ms, median_ms = 1e3 * min(times_s), 1e3 * float(np.median(times_s))
        print(f"{name}: best {best_ms:.1f} ms, median {median_ms:.1f} ms, {threads} threads")


if __name__ == "__main__":
    main()
