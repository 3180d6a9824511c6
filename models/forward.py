"""Forward passes of untrained networks, to compare how fast their layers are (thesis Table 4.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from rig.models.export import Proof, driving_form, serialised, to_onnx
from rig.models.int8 import quantised
from rig.models.names import SCORE_MAPS
from rig.models.networks import make_network
from rig.models.scoremap.grid import path_grid
from rig.models.scoremap.network import ScoreMapNetwork
from rig.models.timing import Times, forward_times
from rig.vision.thumbnail import THUMBNAIL_PX

CALIBRATION_SAMPLES = 4


@dataclass(frozen=True, slots=True)
class Forward:
    """A network's number of parameters and how long its ONNX file takes, in float32 and in 8 bits.

    `int8` is None for a score map, which is not offered in 8 bits.
    """

    parameters: int
    full: Times
    int8: Times | None


def forward(net: str, runs: int) -> Forward:
    """Time `net` with random weights in the form that drives; weights do not change the time."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = _untrained(net)
    parameters = sum(weights.numel() for weights in network.parameters())
    inputs = _random_inputs(net)
    model = to_onnx(driving_form(network), inputs)
    full = forward_times(serialised(model), runs)
    if net in SCORE_MAPS:
        return Forward(parameters, full, None)
    return Forward(parameters, full, forward_times(serialised(quantised(model, *inputs)), runs))


def _untrained(net: str) -> nn.Module:
    if net in SCORE_MAPS:
        return ScoreMapNetwork(path_grid(), width=SCORE_MAPS[net])
    return make_network(net)


def _random_inputs(net: str) -> Proof:
    columns, rows = THUMBNAIL_PX
    shapes = ((6, rows, columns), (8,)) if net in SCORE_MAPS else ((9, 224, 224), (6,))
    rng = np.random.default_rng(0)
    return Proof(
        *(rng.uniform(0, 1, (CALIBRATION_SAMPLES, *shape)).astype(np.float32) for shape in shapes)
    )
