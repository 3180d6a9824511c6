"""How long a network takes for an answer: ONNX Runtime, one thread, one sample at a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime

from rig.controllers.network import NetworkController
from rig.core.types import THESIS_LIMITS, Frame, Settings

RUNS = 100
WARM_UP = 10
BAYER_PX = (2048, 1536)
"""The size of the picture that a decision starts from, the Blackfly's in the thesis."""


@dataclass(frozen=True, slots=True)
class Times:
    """Wall-clock milliseconds of equal runs: the middle one, and that which 1 in 100 exceeds."""

    median_ms: float
    p99_ms: float


@dataclass(frozen=True, slots=True)
class Cost:
    """What an ONNX file costs: its bytes, a forward pass, and a decision from the Bayer picture."""

    size_bytes: int
    forward: Times
    decision: Times


def cost_of(model: Path, runs: int = RUNS) -> Cost:
    """Measure a file that `rig train` wrote."""
    content = model.read_bytes()
    return Cost(len(content), forward_times(content, runs), decision_times(model, runs))


def forward_times(content: bytes, runs: int = RUNS) -> Times:
    """Time an ONNX file's forward pass on one random sample."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(
        content, sess_options=options, providers=["CPUExecutionProvider"]
    )
    rng = np.random.default_rng(0)
    inputs = {
        node.name: rng.uniform(0, 1, (1, *node.shape[1:])).astype(np.float32)
        for node in session.get_inputs()
    }
    return _times(lambda: session.run(None, inputs), runs)


def decision_times(model: Path, runs: int = RUNS) -> Times:
    """Time the controller that runs a file, from a random Bayer picture to settings."""
    controller = NetworkController(model)
    controller.reset(THESIS_LIMITS)
    columns, rows = BAYER_PX
    picture = np.random.default_rng(0).integers(0, 256, (rows, columns), np.uint8)
    frame = Frame(picture, "bayer_rggb8", 0, 0, 0, Settings(1_000.0, 0.0))
    return _times(lambda: controller.step(frame), runs)


def _times(work: Callable[[], object], runs: int) -> Times:
    taken_ms = []
    for _ in range(WARM_UP + runs):
        begun = time.perf_counter()
        work()
        taken_ms.append(1e3 * (time.perf_counter() - begun))
    warm_ms = taken_ms[WARM_UP:]
    return Times(float(np.median(warm_ms)), float(np.percentile(warm_ms, 99)))
