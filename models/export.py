"""From a trained network to the ONNX file that drives a camera, proven equal before it is kept.

The file takes `images` float32 N x 9 x 224 x 224 in 0..1 and `settings` float32 N x 6, and gives
`next_settings` float32 N x 2, all as in `rig.models.networks`; its metadata says what the 0..1 of
the settings mean.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import onnx
import onnxruntime
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from rig.core.errors import ModelError
from rig.core.types import THESIS_LIMITS, Limits
from rig.models.dataset import FRAMES, Batch
from rig.models.int8 import LARGEST_MOVE, MEAN_MOVE, Moved, moved, quantised
from rig.models.networks import ExposureNetwork, with_gain
from rig.models.widen import filled, widened

SCHEMA = "rig.network/1"
INPUT = "RGB 224x224 in 0..1, newest frame first; settings (exposure, gain) scaled to the limits"
LICENCE = "Apache-2.0"
PARITY = 1e-5
HALF_PARITY = 2e-3
SMALLEST_SPREAD = 0.01
HALF_FROM_VALUES = 1024
HALF_SUFFIX = ".half"
"""Ends the names of weights that are stored in half precision."""


@dataclass(frozen=True, slots=True)
class Parity:
    """How far the file's answers lie from the network's, over some samples, in 0..1 of the limits.

    `difference` compares the float32 file with torch, `half_difference` the file with weights
    stored in half precision with the float32 one (0 when they are not). `spread` is the larger
    range of the two outputs: equal answers prove nothing when every answer is the same. `int8` is
    the same for the file in 8-bit integers, None where there is none.
    """

    difference: float
    half_difference: float
    spread: float
    int8: Moved | None = None


def export_network(
    network: nn.Module,
    out: Path,
    samples: Batch,
    *,
    net: str,
    training_sha256: str,
    seed: int,
    limits: Limits = THESIS_LIMITS,
    half: bool = False,
    calibration: Batch | None = None,
) -> Parity:
    """Write `out`, after proving on `samples` that it answers as the network does.

    `half` stores the large weights in half precision, to be widened when the file is loaded: half
    the size, the arithmetic stays float32. With `calibration` samples a second file,
    `int8_file(out)`, has convolutions of 8-bit integers. Raises ModelError when the answers
    differ by more than 1e-5 (2e-3 for half-precision weights; for integers 0.1, or 0.02 in the
    mean) or vary by less than 0.01 over the samples; then no file is written.
    """
    return write_proven(
        network,
        driving_form(network),
        out,
        _shown(samples),
        {"net": net, "training_sha256": training_sha256, "seed": str(seed), "input": INPUT},
        limits=limits,
        half=half,
        calibration=None if calibration is None else _shown(calibration),
    )


def int8_file(out: Path) -> Path:
    """Return where the file in 8-bit integers lies: beside `out`."""
    return out.with_suffix(".int8.onnx")


class Proof(NamedTuple):
    """Inputs on which a file must answer as the trained network does, float32, N samples."""

    images: NDArray[np.float32]
    settings: NDArray[np.float32]


def _shown(samples: Batch) -> Proof:
    return Proof(samples.images.astype(np.float32) / np.float32(255), samples.settings)


def write_proven(
    trained: nn.Module,
    driving: nn.Module,
    out: Path,
    proof: Proof,
    properties: Mapping[str, str],
    *,
    limits: Limits = THESIS_LIMITS,
    half: bool = False,
    calibration: Proof | None = None,
) -> Parity:
    """Write `driving`, the `trained` network in the form that drives, after proving them equal.

    `properties` join the metadata. Raises ModelError as `export_network` does.
    """
    expected = answers_of_torch(trained, proof)
    full = to_onnx(driving, proof)
    answers = answers_of_onnx(full, proof)
    parity = Parity(float(np.abs(answers - expected).max()), 0.0, float(np.ptp(answers, 0).max()))
    files = {out: full}
    if half:
        files[out] = _with_half_weights(full)
        rounded = answers_of_onnx(files[out], proof)
        parity = replace(parity, half_difference=float(np.abs(rounded - answers).max()))
    if calibration is not None:
        files[int8_file(out)] = small = quantised(full, *calibration)
        by = moved(answers, answers_of_onnx(small, proof), len(calibration.images))
        parity = replace(parity, int8=by)
    _require_proof(parity, out)
    out.parent.mkdir(parents=True, exist_ok=True)
    for path, model in files.items():
        _write(model, path, _facts(limits) | dict(properties))
    return parity


def _facts(limits: Limits) -> dict[str, str]:
    """Return the metadata that every file has."""
    return {
        "schema": SCHEMA,
        "exposure_us_lo": str(limits.exposure_us[0]),
        "exposure_us_hi": str(limits.exposure_us[1]),
        "gain_db_lo": str(limits.gain_db[0]),
        "gain_db_hi": str(limits.gain_db[1]),
        "frames": str(FRAMES),
        "licence": LICENCE,
    }


def _write(model: onnx.ModelProto, out: Path, properties: dict[str, str]) -> None:
    onnx.helper.set_model_props(model, properties)
    unfinished = out.with_name(out.name + ".part")
    unfinished.write_bytes(serialised(model))
    unfinished.replace(out)


def serialised(model: onnx.ModelProto) -> bytes:
    """Return the bytes of an ONNX file, equal for equal models."""
    content: bytes = model.SerializeToString(deterministic=True)
    return content


def driving_form(network: nn.Module) -> nn.Module:
    """Return the same function in the form that answers fastest."""
    return _DrivingNetwork(network) if isinstance(network, ExposureNetwork) else network


class _DrivingNetwork(nn.Module):
    """The same function, folded weights worked out once, channels filled to whole blocks."""

    image_weight: Tensor
    settings_weight: Tensor
    bias: Tensor

    def __init__(self, network: ExposureNetwork) -> None:
        super().__init__()
        first = network.first
        self.register_buffer("image_weight", filled(first.image_weight().detach()))
        self.register_buffer("settings_weight", filled(first.settings_weight().detach()))
        self.register_buffer("bias", filled(first.bias.detach()))
        self.pool = first.pool
        self.stages, self.head = widened(network.stages), network.head

    def forward(self, images: Tensor, settings: Tensor) -> Tensor:
        colour = nn.functional.conv2d(images, self.image_weight, self.bias)
        offset = nn.functional.linear(settings, self.settings_weight)
        pooled = nn.functional.max_pool2d(colour, self.pool) + offset[:, :, None, None]
        return with_gain(self.head(torch.flatten(self.stages(pooled), 1)))


def to_onnx(network: nn.Module, proof: Proof) -> onnx.ModelProto:
    """Return `network` as ONNX, for any number of samples shaped as those of `proof`."""
    example = tuple(torch.zeros(2, *values.shape[1:]) for values in proof)
    batch = torch.export.Dim("batch")
    with _quiet_exporter():
        program = torch.onnx.export(
            network.cpu().eval(),
            example,
            dynamo=True,
            external_data=False,
            verbose=False,
            input_names=["images", "settings"],
            output_names=["next_settings"],
            dynamic_shapes={"images": {0: batch}, "settings": {0: batch}},
        )
    assert program is not None
    model: onnx.ModelProto = program.model_proto
    for described in (*model.graph.node, *model.graph.value_info, model.graph):
        described.ClearField("metadata_props")
    return model


@contextmanager
def _quiet_exporter() -> Iterator[None]:
    """Keep the exporter's notices about its own insides from the person who trains."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _with_half_weights(model: onnx.ModelProto) -> onnx.ModelProto:
    """Return the model with every large float32 weight as float16 and a cast behind it."""
    halved = onnx.ModelProto()
    halved.CopyFrom(model)
    graph = halved.graph
    casts = []
    for index, weight in enumerate(graph.initializer):
        values = onnx.numpy_helper.to_array(weight)
        if weight.data_type != onnx.TensorProto.FLOAT or values.size < HALF_FROM_VALUES:
            continue
        stored = weight.name + HALF_SUFFIX
        casts.append(
            onnx.helper.make_node("Cast", [stored], [weight.name], to=onnx.TensorProto.FLOAT)
        )
        graph.initializer[index].CopyFrom(
            onnx.numpy_helper.from_array(values.astype(np.float16), stored)
        )
    nodes = [*casts, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)
    onnx.checker.check_model(halved)
    return halved


def answers_of_torch(network: nn.Module, proof: Proof) -> NDArray[np.float32]:
    """Return what a network answers, N x 2 in 0..1 of the limits; it is in evaluation then."""
    network.eval()
    device = next(network.parameters()).device
    with torch.inference_mode():
        answers = network(*(torch.from_numpy(values).to(device) for values in proof))
    return np.asarray(answers.cpu().numpy(), np.float32)


def answers_of_onnx(model: onnx.ModelProto, proof: Proof) -> NDArray[np.float32]:
    """Return what a file answers, N x 2 in 0..1 of the limits."""
    session = onnxruntime.InferenceSession(
        model.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    inputs = {"images": proof.images, "settings": proof.settings}
    return np.asarray(session.run(["next_settings"], inputs)[0], np.float32)


def _require_proof(parity: Parity, out: Path) -> None:
    if not parity.difference <= PARITY:
        raise ModelError(
            f"{out}: the exported network answers differently by {parity.difference:.2g} "
            f"(allowed {PARITY:g}); it was not written"
        )
    if not parity.half_difference <= HALF_PARITY:
        raise ModelError(
            f"{out}: half-precision weights change answers by {parity.half_difference:.2g} "
            f"(allowed {HALF_PARITY:g}); store them in full"
        )
    if parity.int8 is not None and not parity.int8.allowed:
        raise ModelError(
            f"{out}: 8-bit integers move answers by {parity.int8.mean:.2g} in the mean and at most "
            f"{parity.int8.largest:.2g} (allowed {MEAN_MOVE:g} and {LARGEST_MOVE:g}); nothing was "
            "written; leave out --int8, training goes on from its checkpoint"
        )
    if not parity.spread >= SMALLEST_SPREAD:
        raise ModelError(
            f"{out}: the network answers nearly the same to every picture (range "
            f"{parity.spread:.2g} of the limits) and was not written; give more --epochs, training "
            "goes on from its checkpoint, or more varied recordings"
        )
