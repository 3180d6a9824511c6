"""Looks at an ONNX file before it is run: a file from elsewhere may be made to do harm.

A few bytes can ask for gigabytes of memory or loop for ever. So the file is walked here without
any library: only plain arithmetic that a network needs may be in it, nothing that loops, branches,
reads other files or makes tensors from numbers. What passes is loaded and run once in a process
of its own, with its memory and processor time limited.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

MAX_BYTES = 256 << 20
MAX_NODES = 20_000
MAX_ELEMENTS = 1 << 28
MAX_RANK = 8

OPERATORS = frozenset(
    {
        "Abs", "Add", "And", "ArgMax", "ArgMin", "AveragePool", "BatchNormalization", "Cast",
        "Ceil", "Clip", "Concat", "Constant", "Conv", "ConvInteger", "ConvTranspose",
        "DepthToSpace", "DequantizeLinear", "Div", "Dropout", "DynamicQuantizeLinear", "Elu",
        "Equal", "Erf", "Exp", "Flatten", "Floor", "Gather", "Gelu", "Gemm", "GlobalAveragePool",
        "GlobalMaxPool", "Greater", "GreaterOrEqual", "GroupNormalization", "HardSigmoid",
        "HardSwish", "Identity", "InstanceNormalization", "LayerNormalization", "LeakyRelu",
        "Less", "LessOrEqual", "Log", "LogSoftmax", "MatMul", "MatMulInteger", "Max", "MaxPool",
        "Mean", "Min", "Mish", "Mul", "Neg", "Not", "Or", "PRelu", "Pad", "Pow", "QLinearConv",
        "QLinearMatMul", "QuantizeLinear", "Reciprocal", "ReduceL2", "ReduceMax", "ReduceMean",
        "ReduceMin", "ReduceProd", "ReduceSum", "Relu", "Reshape", "Resize", "Round", "Selu",
        "Shape", "Sigmoid", "Sign", "Slice", "Softmax", "Softplus", "Softsign", "SpaceToDepth",
        "Split", "Sqrt", "Squeeze", "Sub", "Sum", "Tanh", "Transpose", "Unsqueeze", "Where",
    }
)  # fmt: skip
"""Operators of the ONNX standard that a network may use."""

_TRIAL_CPU_S = 2
_TRIAL_WALL_S = 60
_TRIAL_BYTES = 160 << 20
_TRIAL_BYTES_PER_BYTE = 8

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5

_MODEL_GRAPH, _MODEL_TRAINING, _MODEL_FUNCTIONS = 7, 20, 25
_GRAPH_NODE, _GRAPH_INITIALIZER, _GRAPH_INPUT, _GRAPH_SPARSE = 1, 5, 11, 15
_NODE_OPERATOR, _NODE_ATTRIBUTE, _NODE_DOMAIN = 4, 5, 7
_ATTRIBUTE_TENSOR, _ATTRIBUTE_TENSORS = 5, 10
_ATTRIBUTE_GRAPHS = {6: "graph", 11: "graphs", 22: "sparse tensor", 23: "sparse tensors"}
_TENSOR_DIMS, _TENSOR_EXTERNAL, _TENSOR_LOCATION = 1, 13, 14


def read_model(path: Path) -> bytes:
    """Return a file's bytes, but no more than one too many; raises OSError."""
    with path.open("rb") as file:
        return file.read(MAX_BYTES + 1)


def check_model(content: bytes) -> None:
    """Raise ValueError, with the reason in a few words, when the bytes must not be run."""
    if len(content) > MAX_BYTES:
        raise ValueError(f"it has over {MAX_BYTES} bytes")
    graphs = 0
    for number, value in _fields(memoryview(content)):
        if number in (_MODEL_TRAINING, _MODEL_FUNCTIONS):
            raise ValueError("it defines functions of its own")
        if number == _MODEL_GRAPH:
            graphs += 1
            _check_graph(_view(value))
    if graphs != 1:
        raise ValueError(f"it holds {graphs} graphs, not one")


@lru_cache(maxsize=64)
def try_model(content: bytes) -> None:
    """Load and run the bytes once in a process that may take little memory and time.

    Raises ValueError with the reason when that fails.
    """
    room = _TRIAL_BYTES + _TRIAL_BYTES_PER_BYTE * len(content)
    command = [sys.executable, "-m", "rig.controllers.onnx_trial", str(room), str(_TRIAL_CPU_S)]
    try:
        trial = subprocess.run(command, input=content, capture_output=True, timeout=_TRIAL_WALL_S)
    except subprocess.TimeoutExpired:
        raise ValueError(f"it did not answer within {_TRIAL_WALL_S} s") from None
    if trial.returncode < 0:
        raise ValueError(
            f"it took more than {_TRIAL_CPU_S} s of processor time or {room >> 20} MB of memory"
        )
    if trial.returncode > 0:
        raise ValueError(trial.stderr.decode(errors="replace").strip().splitlines()[-1])


def _check_graph(graph: memoryview) -> None:
    nodes = 0
    for number, value in _fields(graph):
        if number == _GRAPH_NODE:
            nodes += 1
            _check_node(_view(value))
        elif number == _GRAPH_INITIALIZER:
            _check_tensor(_view(value))
        elif number == _GRAPH_SPARSE:
            raise ValueError("it holds sparse tensors")
    if nodes > MAX_NODES:
        raise ValueError(f"{nodes} operators are over {MAX_NODES}")


def _check_node(node: memoryview) -> None:
    operator, domain = "", ""
    for number, value in _fields(node):
        if number == _NODE_OPERATOR:
            operator = _text(value)
        elif number == _NODE_DOMAIN:
            domain = _text(value)
        elif number == _NODE_ATTRIBUTE:
            _check_attribute(_view(value))
    if domain not in ("", "ai.onnx") or operator not in OPERATORS:
        raise ValueError(f"operator {domain + '.' if domain else ''}{operator} is not allowed")


def _check_attribute(attribute: memoryview) -> None:
    for number, value in _fields(attribute):
        if number in _ATTRIBUTE_GRAPHS:
            raise ValueError(f"an operator holds a {_ATTRIBUTE_GRAPHS[number]} of its own")
        if number in (_ATTRIBUTE_TENSOR, _ATTRIBUTE_TENSORS):
            _check_tensor(_view(value))


def _check_tensor(tensor: memoryview) -> None:
    dimensions: list[int] = []
    for number, value in _fields(tensor):
        if number == _TENSOR_EXTERNAL or (number == _TENSOR_LOCATION and value != 0):
            raise ValueError("it keeps tensors in other files")
        if number == _TENSOR_DIMS:
            dimensions += [value] if isinstance(value, int) else _varints(value)
    elements = 1
    for size in dimensions:
        elements *= size
    if len(dimensions) > MAX_RANK or elements > MAX_ELEMENTS:
        raise ValueError(f"a tensor of shape {dimensions[: MAX_RANK + 1]} is too large")


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Yield (number, value) of each field of a protobuf message; raises ValueError."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, kind = key >> 3, key & 7
        if kind == _VARINT:
            value, at = _varint(message, at)
            yield number, value
            continue
        if kind == _BYTES:
            size, at = _varint(message, at)
        elif kind in (_FIXED32, _FIXED64):
            size = 4 if kind == _FIXED32 else 8
        else:
            raise ValueError("it is no ONNX file")
        if size > len(message) - at:
            raise ValueError("it is cut short")
        yield number, message[at : at + size]
        at += size


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(message):
            raise ValueError("it is cut short")
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("it is no ONNX file")


def _varints(packed: memoryview) -> list[int]:
    values: list[int] = []
    at = 0
    while at < len(packed) and len(values) <= MAX_RANK:
        value, at = _varint(packed, at)
        values.append(value)
    return values


def _view(value: int | memoryview) -> memoryview:
    if isinstance(value, int):
        raise ValueError("it is no ONNX file")
    return value


def _text(value: int | memoryview) -> str:
    return bytes(_view(value)[:100]).decode(errors="replace")
