"""How long a decision takes, and what the looking at a sample of the picture changes.

    python tools/bench_controllers.py [--size 2048x1536] [--model FILE.onnx]

Times are processor time of one thread, so that a busy machine does not matter. Every decision is
timed in a closed loop on pictures whose brightness follows the settings, so that searches search.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from rig.controllers.registry import ALIASES, CONTROLLERS, make_controller
from rig.core.autoexposure import AutoExposure, metered_dn
from rig.core.types import THESIS_LIMITS, Command, Frame, Settings
from rig.core.units import gain_factor
from rig.vision.bayer import to_bgr, to_grey, to_rgb224
from rig.vision.matching import mutual_matches
from rig.vision.metrics import kim, score, shin
from rig.vision.orb import OrbFrontEnd

REPEATS, FRAMES = 15, 60
LIMIT_MS = {"kim": 10.0}
LIMIT_ELSE_MS = 5.0


def scene(width_px: int, height_px: int) -> NDArray[np.float32]:
    """Return blobs of all sizes, mean 1."""
    rng = np.random.default_rng(0)
    picture = np.zeros((height_px, width_px), np.float32)
    for scale in (3, 8, 30, 120):
        side = (height_px // scale + 2, width_px // scale + 2)
        blobs = rng.normal(0, 1, side).astype(np.float32)
        picture += cv2.resize(blobs, (width_px, height_px), interpolation=cv2.INTER_CUBIC)
    return np.maximum(1 + 0.27 * picture, 0).astype(np.float32)


def shoot(wall: NDArray[np.float32], used: Settings) -> Frame:
    """Return a noisy frame of the wall in a light of 0.03 grey levels a microsecond."""
    gain = gain_factor(used.gain_db)
    rng = np.random.default_rng(int(used.exposure_us * 10 + used.gain_db))
    noise = rng.standard_normal(wall.shape, dtype=np.float32) * np.float32(0.5 * gain + 0.5)
    bright = wall * np.float32(0.03 * used.exposure_us * gain) + noise
    image = np.clip(np.rint(bright), 0, 255).astype(np.uint8)
    return Frame(image, "bayer_rggb8", 0, 0, 0, used)


class Loop:
    """A controller before the wall."""

    def __init__(self, spec: str, wall: NDArray[np.float32]) -> None:
        self.controller = make_controller(spec, seed=0, networks={}).controller
        self._wall = wall
        self._law: AutoExposure | None = None
        self._command: Command = self.controller.reset(THESIS_LIMITS)

    def frame(self) -> Frame:
        if isinstance(self._command, Settings):
            return shoot(self._wall, self._command)
        law = self._law or AutoExposure.begun(self._command)
        frame = shoot(self._wall, law.settings)
        self._law = law.after(metered_dn(frame.image, self._command.metering))
        return frame

    def decide(self, frame: Frame) -> float:
        """Return the milliseconds of a decision."""
        start_ns = time.thread_time_ns()
        self._command = self.controller.step(frame)
        self.controller.diagnostics()
        return (time.thread_time_ns() - start_ns) / 1e6

    @property
    def command(self) -> Command:
        return self._command


def bench_decisions(specs: list[str], wall: NDArray[np.float32]) -> None:
    for spec in specs:
        loop = Loop(spec, wall)
        costs_ms = [loop.decide(loop.frame()) for _ in range(FRAMES)][2:]
        limit_ms = LIMIT_MS.get(spec, LIMIT_ELSE_MS)
        verdict = "" if np.quantile(costs_ms, 0.99) < limit_ms else f"  OVER {limit_ms:g} ms"
        print(f"decide {spec.partition(':')[0]:25s} {tell(costs_ms)}{verdict}")


def tell(costs_ms: list[float]) -> str:
    return f"median {np.median(costs_ms):7.2f}  p99 {np.quantile(costs_ms, 0.99):7.2f} ms"


def bench(name: str, work: Callable[[], object]) -> None:
    work()
    costs_ms = []
    for _ in range(REPEATS):
        start_ns = time.thread_time_ns()
        work()
        costs_ms.append((time.thread_time_ns() - start_ns) / 1e6)
    print(f"{name:32s} {tell(costs_ms)}")


def effect_of_sampling(wall: NDArray[np.float32]) -> None:
    """Print where each method comes to rest when it looks at a sample, and at every pixel."""
    from rig.vision.metrics import sampling

    tiles_seen = sampling.TILE_PX
    for spec in ("shin", "lu", "shim", "zhang", "geomean"):
        rests = []
        for whole in (False, True):
            before = sampling.SMALL_PX
            sampling.SMALL_PX = 10**6 if whole else before
            loop = Loop(spec, wall)
            for _ in range(FRAMES * 2):
                loop.decide(loop.frame())
            sampling.SMALL_PX = before
            rests.append(loop.command)
        sampled, full = rests
        assert isinstance(sampled, Settings) and isinstance(full, Settings)
        stops = np.log2(sampled.exposure_us / full.exposure_us)
        stops += (sampled.gain_db - full.gain_db) / (20 * np.log10(2))
        print(
            f"{spec:8s} rests with a sample ({tiles_seen} px tiles) at "
            f"{sampled.exposure_us:7.0f} us {sampled.gain_db:5.2f} dB, with every pixel at "
            f"{full.exposure_us:7.0f} us {full.gain_db:5.2f} dB: {stops:+.2f} stops"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", default="2048x1536")
    parser.add_argument("--model", type=Path, help="an ONNX network to time as a controller")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    numba.set_num_threads(1)
    width_px, height_px = (int(side) for side in arguments.size.split("x"))
    wall = scene(width_px, height_px)
    specs = sorted({*CONTROLLERS, *ALIASES} - {"network"})
    specs += [f"network:model={arguments.model}"] if arguments.model else []
    bench_decisions(specs, wall)
    effect_of_sampling(scene(1024, 768))

    image = shoot(wall, Settings(3_000.0, 2.0)).image
    bgr, grey = to_bgr(image, "bayer_rggb8"), to_grey(image, "bayer_rggb8")
    front_end = OrbFrontEnd()
    features = front_end.features(grey)
    shifted = front_end.features(np.roll(grey, 16, axis=1))
    opencv = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    bench("to_rgb224", lambda: to_rgb224(image, "bayer_rggb8"))
    bench("to_grey", lambda: to_grey(image, "bayer_rggb8"))
    bench("shin, every pixel", lambda: shin(bgr))
    bench("kim", lambda: kim(grey))
    bench("every metric of rig metrics", lambda: score(bgr))
    bench(f"orb features ({len(features)})", lambda: front_end.features(grey))
    bench("orb match with inliers", lambda: front_end.match(features, shifted))
    bench("  mutual_matches", lambda: mutual_matches(features.descriptors, shifted.descriptors))
    bench("  OpenCV cross-check", lambda: opencv.match(features.descriptors, shifted.descriptors))


if __name__ == "__main__":
    main()
