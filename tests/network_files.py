"""ONNX files of the networks' interface, small enough to know their answers by heart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import NodeProto, TensorProto, helper

METADATA = {
    "schema": "rig.network/1",
    "frames": "3",
    "exposure_us_lo": "75",
    "exposure_us_hi": "30000",
    "gain_db_lo": "0",
    "gain_db_hi": "30",
}
SHAPES: dict[str, Sequence[int | str]] = {
    "images": ["N", 9, 224, 224],
    "settings": ["N", 6],
    "next_settings": ["N", 2],
}


def write(
    path: Path,
    nodes: list[NodeProto],
    constants: dict[str, NDArray[np.float32] | NDArray[np.int64]],
    *,
    metadata: dict[str, str] = METADATA,
    shapes: dict[str, Sequence[int | str]] = SHAPES,
    kind: int = TensorProto.FLOAT,
) -> Path:
    """Write an ONNX file whose last shape is its output."""
    *inputs, output = [
        helper.make_tensor_value_info(name, kind, shape) for name, shape in shapes.items()
    ]
    initial = [onnx.numpy_helper.from_array(value, name) for name, value in constants.items()]
    graph = helper.make_graph(nodes, "test", inputs, [output], initial)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=9)
    helper.set_model_props(model, metadata)
    onnx.save(model, path)
    return path


def linear(
    path: Path,
    weights: NDArray[np.float32],
    offset: Sequence[float] = (0.0, 0.0),
    **form: dict[str, Any],
) -> Path:
    """Write a network that answers with all channel means, then 6 settings, times `weights`."""
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["means"], axes=[2, 3], keepdims=0),
        helper.make_node("Concat", ["means", "settings"], ["features"], axis=1),
        helper.make_node("MatMul", ["features", "weights"], ["product"]),
        helper.make_node("Add", ["product", "offset"], ["next_settings"]),
    ]
    constants = {"weights": weights, "offset": np.array(offset, np.float32)}
    return write(path, nodes, constants, **form)


def constant(path: Path, answer: Sequence[float]) -> Path:
    """Write a network that answers the same whatever it sees."""
    return linear(path, np.zeros((15, 2), np.float32), answer)
