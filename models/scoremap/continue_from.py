"""A score-map network that answers as an exported file does, to go on training from there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from rig.core.errors import ModelError
from rig.models.export import HALF_SUFFIX, Proof, answers_of_onnx, answers_of_torch
from rig.models.scoremap.network import ScoreMapNetwork

ALIKE = 1e-3
"""Answers may differ by so much of the limits where the file chose between two equal cells."""


def begin_with(network: ScoreMapNetwork, model: Path, proof: Proof) -> None:
    """Give `network` the weights of a file that `rig train` wrote for the same kind of network.

    `proof` are samples as the network takes them: an exported file has most batch normalisations
    folded into the layer before, and these must begin with the spread of what they are given
    there. Raises ModelError when the file is of another kind or the network does not answer as it
    does.
    """
    stored = _load(model)
    weights = _weights(stored)
    own = network.state_dict()
    known = {name: weights[name] for name in own if name in weights}
    if any(own[name].shape != values.shape for name, values in known.items()) or not known:
        raise ModelError(f"{model}: not a score map of this kind and grid; choose its own --net")
    network.eval().load_state_dict(known, strict=False)
    for name, layer in network.named_modules():
        folded = f"{name}.running_mean" not in weights
        if isinstance(layer, nn.BatchNorm1d | nn.BatchNorm2d) and folded:
            _pass_on(layer, network, proof)
    apart = np.abs(answers_of_torch(network, proof) - answers_of_onnx(stored, proof)).max(1)
    if not np.mean(apart < ALIKE) > 0.99:
        raise ModelError(
            f"{model}: a network with its weights answers otherwise (by up to {apart.max():.2g} of "
            "the limits); begin with a file that `rig train` wrote"
        )


def _pass_on(
    layer: nn.BatchNorm1d | nn.BatchNorm2d, network: ScoreMapNetwork, proof: Proof
) -> None:
    """Let a normalisation give back what it is given, in training too, as far as batches agree."""
    given: list[Tensor] = []
    hook = layer.register_forward_hook(lambda _layer, inputs, _output: given.append(inputs[0]))
    answers_of_torch(network, proof)
    hook.remove()
    values = given[0].transpose(0, 1).flatten(1)
    mean, variance = values.mean(1), values.var(1, unbiased=False)
    assert layer.running_mean is not None and layer.running_var is not None
    layer.running_mean.copy_(mean)
    layer.running_var.copy_(variance)
    layer.weight.data.copy_(torch.sqrt(variance + layer.eps))
    layer.bias.data.copy_(mean)


def _load(model: Path) -> onnx.ModelProto:
    try:
        return onnx.load(model)
    except Exception as error:  # a broken file raises what its decoder has, which has no types
        raise ModelError(f"{model}: no network to begin with ({error})") from error


def _weights(stored: onnx.ModelProto) -> dict[str, Tensor]:
    """Return the weights of a file by their names in the network, widened to float32."""
    return {
        one.name.removesuffix(HALF_SUFFIX): torch.from_numpy(
            np.array(numpy_helper.to_array(one), np.float32)
        )
        for one in stored.graph.initializer
    }
