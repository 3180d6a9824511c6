"""An ONNX file from anybody: refused in one line, within 2 s of work and 256 MB, or run."""

from __future__ import annotations

import os
import random
import resource
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from network_files import METADATA
from onnx import NodeProto, TensorProto, helper
from onnx.numpy_helper import from_array

from rig.controllers.network import NetworkController
from rig.controllers.onnx_guard import OPERATORS, check_model, try_model
from rig.core.errors import ModelError
from rig.core.types import Frame, Limits, Settings

SHIPPED = Path(__file__).parents[2] / "models" / "weights" / "ours.onnx"


def model(nodes: list[NodeProto], initial: dict[str, np.ndarray[Any, Any]]) -> onnx.ModelProto:
    value = helper.make_tensor_value_info
    graph = helper.make_graph(
        nodes,
        "test",
        [
            value("images", TensorProto.FLOAT, ["N", 9, 224, 224]),
            value("settings", TensorProto.FLOAT, ["N", 6]),
        ],
        [value("next_settings", TensorProto.FLOAT, ["N", 2])],
        [from_array(array, name) for name, array in initial.items()],
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=9)
    helper.set_model_props(made, METADATA)
    return made


def node(kind: str, inputs: str, output: str, **attributes: Any) -> NodeProto:
    return helper.make_node(kind, inputs.split(), [output], **attributes)


HEAD = [node("Slice", "settings zero two one", "next_settings")]
BOUNDS = {"zero": np.array([0]), "two": np.array([2]), "one": np.array([1])}


def answer(big: str) -> list[NodeProto]:
    """Return nodes that make the answer depend on the tensor `big`."""
    return [
        node("ReduceMax", big, "most", keepdims=0),
        node("Slice", "settings zero two one", "head"),
        node("Add", "head most", "next_settings"),
    ]


def looping() -> onnx.ModelProto:
    more, always = TensorProto.BOOL, np.array(True)
    body = helper.make_graph(
        [node("Identity", "go", "on")],
        "body",
        [
            helper.make_tensor_value_info("i", TensorProto.INT64, []),
            helper.make_tensor_value_info("go", more, []),
        ],
        [helper.make_tensor_value_info("on", more, [])],
    )
    loop = helper.make_node("Loop", ["", "always"], [], body=body)
    return model([*HEAD, loop], {**BOUNDS, "always": always})


def constant_of_shape() -> onnx.ModelProto:
    nodes = [node("ConstantOfShape", "shape", "big"), *answer("big")]
    return model(nodes, {"shape": np.array([1 << 30]), **BOUNDS})


def expanding(kind: str, sizes: list[int]) -> onnx.ModelProto:
    nodes = [node(kind, "one_float sizes", "big"), *answer("big")]
    one = np.ones((1, 1), np.float32)
    return model(nodes, {"one_float": one, "sizes": np.array(sizes), **BOUNDS})


def outer_product() -> onnx.ModelProto:
    """A column plus a row: two small tensors make a large one."""
    nodes = [node("Add", "column row", "big"), *answer("big")]
    column = np.ones((40_000, 1), np.float32)
    return model(nodes, {"column": column, "row": column.reshape(1, -1), **BOUNDS})


def resized() -> onnx.ModelProto:
    nodes = [node("Resize", "images  scales", "big"), *answer("big")]
    nodes[0].input[:] = ["images", "", "scales"]
    return model(nodes, {"scales": np.array([1, 1, 100, 100], np.float32), **BOUNDS})


def padded() -> onnx.ModelProto:
    nodes = [node("Pad", "images pads", "big"), *answer("big")]
    pads = np.array([0, 0, 0, 0, 0, 0, 30_000, 3_000])
    return model(nodes, {"pads": pads, **BOUNDS})


def slow() -> onnx.ModelProto:
    """Products of matrices that fit into memory, one after the other, of no constants only."""
    nodes = [node("MatMul", f"m{n} m0", f"m{n + 1}") for n in range(400)]
    first = [
        node("ReduceMax", "settings", "given", keepdims=0),
        node("Add", "column row", "constant"),
        node("Add", "constant given", "m0"),
    ]
    nodes = [*first, *nodes, *answer("m400")]
    column = np.full((1_500, 1), 1e-9, np.float32)
    return model(nodes, {"column": column, "row": column.reshape(1, -1), **BOUNDS})


def external() -> onnx.ModelProto:
    made = model(HEAD, dict(BOUNDS))
    tensor = made.graph.initializer[0]
    tensor.data_location = TensorProto.EXTERNAL
    tensor.ClearField("raw_data")
    tensor.external_data.add(key="location", value="/etc/passwd")
    return made


def with_function() -> onnx.ModelProto:
    made = model([*HEAD], dict(BOUNDS))
    own = helper.make_function(
        "own", "F", ["x"], ["y"], [node("Relu", "x", "y")], [helper.make_opsetid("", 20)]
    )
    made.functions.append(own)
    return made


def foreign_domain() -> onnx.ModelProto:
    made = model([*HEAD], dict(BOUNDS))
    made.graph.node[0].domain = "com.microsoft"
    return made


def sparse() -> onnx.ModelProto:
    made = model([*HEAD], dict(BOUNDS))
    made.graph.sparse_initializer.add()
    return made


def huge_shape() -> onnx.ModelProto:
    made = model([*HEAD], dict(BOUNDS))
    made.graph.initializer[0].dims[:] = [1 << 20, 1 << 20]
    return made


HOSTILE = {
    "Loop": (looping, "graph of its own|Loop is not allowed"),
    "ConstantOfShape": (constant_of_shape, "ConstantOfShape is not allowed"),
    "Expand": (lambda: expanding("Expand", [1 << 15, 1 << 15]), "Expand is not allowed"),
    "Tile": (lambda: expanding("Tile", [1 << 15, 1 << 15]), "Tile is not allowed"),
    "outer product": (outer_product, "llocat|memory"),
    "Resize": (resized, "llocat|memory"),
    "Pad": (padded, "llocat|memory"),
    "slow": (slow, "2 s of processor time"),
    "external data": (external, "other files"),
    "functions": (with_function, "functions of its own"),
    "domain": (foreign_domain, r"com\.microsoft\.Slice is not allowed"),
    "sparse": (sparse, "sparse"),
    "huge shape": (huge_shape, "too large"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_network_is_refused_in_little_time_and_memory(tmp_path: Path, name: str) -> None:
    make, words = HOSTILE[name]
    path = tmp_path / "hostile.onnx"
    path.write_bytes(make().SerializeToString())
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with pytest.raises(ModelError, match=words) as refused:
        NetworkController(path)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert "\n" not in str(refused.value)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 5.0
    assert after.ru_maxrss < 256 << 10 or after.ru_maxrss == before.ru_maxrss


def test_a_small_convolutional_network_of_ordinary_parts_is_run(tmp_path: Path) -> None:
    random_numbers = np.random.default_rng(0)

    def weights(*shape: int) -> np.ndarray[Any, Any]:
        return random_numbers.normal(0, 0.1, shape).astype(np.float32)

    nodes = [
        node("Conv", "images w0 b0", "c0", strides=[8, 8]),
        node("BatchNormalization", "c0 scale shift mean variance", "n0"),
        node("HardSwish", "n0", "a0"),
        node("MaxPool", "a0", "p0", kernel_shape=[2, 2], strides=[2, 2]),
        node("Conv", "p0 w1", "c1"),
        node("LeakyRelu", "c1", "a1"),
        node("AveragePool", "a1", "p1", kernel_shape=[2, 2]),
        node("GlobalAveragePool", "p1", "g"),
        node("Flatten", "g", "f"),
        node("Concat", "f settings", "all", axis=1),
        node("Gemm", "all w2 b2", "h"),
        node("Softmax", "h", "s"),
        node("Log", "s", "l"),
        node("Reshape", "l shape", "r"),
        node("Transpose", "r", "t", perm=[0, 2, 1]),
        node("ReduceSum", "t axis", "u", keepdims=0),
        node("Sigmoid", "u", "v"),
        node("Clip", "v low high", "next_settings"),
    ]
    initial = {
        "w0": weights(4, 9, 8, 8), "b0": weights(4),
        "scale": np.ones(4, np.float32), "shift": weights(4),
        "mean": weights(4), "variance": np.ones(4, np.float32),
        "w1": weights(6, 4, 3, 3), "w2": weights(12, 6), "b2": weights(6),
        "shape": np.array([-1, 2, 3]), "axis": np.array([1]),
        "low": np.array(0.0, np.float32), "high": np.array(1.0, np.float32),
    }  # fmt: skip
    made = model(nodes, initial)
    made.graph.node[-3].CopyFrom(node("ReduceSum", "t axis", "u", keepdims=0))
    path = tmp_path / "small.onnx"
    del made.graph.output[0].type.tensor_type.shape.dim[:]
    for size in ("N", 2):
        dimension = made.graph.output[0].type.tensor_type.shape.dim.add()
        if isinstance(size, str):
            dimension.dim_param = size
        else:
            dimension.dim_value = size
    path.write_bytes(made.SerializeToString())
    controller = NetworkController(path)
    first = controller.reset(Limits())
    assert isinstance(first, Settings)
    image = np.full((96, 128), 90, np.uint8)
    assert isinstance(controller.step(Frame(image, "mono8", 0, 0, 0, first)), Settings)


def test_the_shipped_network_is_accepted() -> None:
    content = SHIPPED.read_bytes()
    check_model(content)
    try_model(content)


def test_nothing_that_loops_or_makes_tensors_is_allowed() -> None:
    looping = {"Loop", "If", "Scan", "SequenceMap", "RNN", "LSTM", "GRU"}
    making = {"ConstantOfShape", "Expand", "Tile", "Range", "RandomNormal", "EyeLike", "OneHot"}
    hostile = looping | making | {"NonZero", "CumSum", "Einsum"}
    assert not hostile & OPERATORS


def test_damaged_bytes_are_refused_by_name_or_pass_the_check() -> None:
    content = model(HEAD, dict(BOUNDS)).SerializeToString()
    draw = random.Random(0)
    for _ in range(2_000):
        damaged = bytearray(content)
        for _ in range(draw.randint(1, 4)):
            damaged[draw.randrange(len(damaged))] = draw.randrange(256)
        try:
            check_model(bytes(damaged[: draw.randint(1, len(damaged))]))
        except ValueError as error:
            assert str(error)


def test_more_bytes_than_a_network_has_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large.onnx"
    path.touch()
    os.truncate(path, 1 << 40)
    with pytest.raises(ModelError, match=r"has over 268435456 bytes"):
        NetworkController(path)
