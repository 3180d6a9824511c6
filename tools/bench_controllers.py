"""How long one decision takes, in milliseconds of one core, so that a busy machine does not matter.

python tools/bench_controllers.py [--size 2048x1536] [--model FILE.onnx]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from rig.controllers.registry import make_controller
from rig.core.types import THESIS_LIMITS, Frame, Settings
from rig.vision.bayer import to_bgr, to_grey, to_rgb224
from rig.vision.matching import mutual_matches
from rig.vision.metrics import shin
from rig.vision.orb import OrbFrontEnd

REPEATS = 30


def scene(width_px: int, height_px: int) -> np.ndarray:
    """Return blobs of all sizes with the noise of a moderate gain."""
    rng = np.random.default_rng(0)
    picture = np.zeros((height_px, width_px))
    for scale in (3, 8, 30, 120):
        side = (height_px // scale + 2, width_px // scale + 2)
        blobs = rng.normal(0, 1, side).astype(np.float32)
        picture += cv2.resize(blobs, (width_px, height_px), interpolation=cv2.INTER_CUBIC)
    return np.clip(110 + 30 * picture + rng.normal(0, 3, picture.shape), 0, 255).astype(np.uint8)


def measure(name: str, work: Callable[[], object]) -> None:
    work()
    costs_ms = []
    for _ in range(REPEATS):
        start_ns = time.thread_time_ns()
        work()
        costs_ms.append((time.thread_time_ns() - start_ns) / 1e6)
    print(
        f"{name:32s} median {np.median(costs_ms):7.2f}  p99 {np.quantile(costs_ms, 0.99):7.2f} ms"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", default="2048x1536")
    parser.add_argument("--model", type=Path, help="an ONNX network to time as a controller")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    width_px, height_px = (int(side) for side in arguments.size.split("x"))
    image = scene(width_px, height_px)
    frame = Frame(image, "bayer_rggb8", 0, 0, 0, Settings(5_000.0, 6.0))
    bgr, grey = to_bgr(image, "bayer_rggb8"), to_grey(image, "bayer_rggb8")

    specs = ["fixed", "aeag", "shin"]
    specs += [f"network:model={arguments.model}"] if arguments.model else []
    for spec in specs:
        controller = make_controller(spec, seed=0, networks={}).controller
        controller.reset(THESIS_LIMITS)
        measure(f"decide {spec.partition(':')[0]}", lambda step=controller.step: step(frame))

    front_end = OrbFrontEnd()
    features = front_end.features(grey)
    shifted = front_end.features(np.roll(grey, 16, axis=1))
    opencv = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    measure("to_rgb224", lambda: to_rgb224(image, "bayer_rggb8"))
    measure("to_grey", lambda: to_grey(image, "bayer_rggb8"))
    measure("shin, every pixel", lambda: shin(bgr))
    measure(f"orb features ({len(features)})", lambda: front_end.features(grey))
    measure("orb match with inliers", lambda: front_end.match(features, shifted))
    measure("  mutual_matches", lambda: mutual_matches(features.descriptors, shifted.descriptors))
    measure("  OpenCV cross-check", lambda: opencv.match(features.descriptors, shifted.descriptors))


if __name__ == "__main__":
    main()
