"""A network whose convolutions count in 8-bit integers: a smaller file and a faster answer.

Weights get one scale a channel; the scales of what flows between layers come from samples, once,
so a drive needs none (static quantisation). The fully connected layers stay float32: they are
about a tenth of the weights or less and hardly any of the time, and rounding the ones of
`dual-small` too moved its answers twenty times as far.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import onnx
from numpy.typing import NDArray
from onnxruntime import quantization
from onnxruntime.quantization.quant_utils import add_pre_process_metadata

OPERATORS = ("Conv", "MaxPool")
"""Convolutions, and the pooling behind them, so that it sees integers too."""

MEAN_MOVE = 0.02
LARGEST_MOVE = 0.1


@dataclass(frozen=True, slots=True)
class Moved:
    """By how much integers moved answers, in 0..1 of the limits, over the samples of the proof.

    `mean` is that of the setting that moved more, `largest` is over both; `calibration` is the
    number of other samples that the scales were taken from.
    """

    mean: float
    largest: float
    calibration: int

    @property
    def allowed(self) -> bool:
        """Return whether the file is worth keeping: it answers nearly as the float32 one."""
        return self.mean <= MEAN_MOVE and self.largest <= LARGEST_MOVE


def moved(before: NDArray[np.float32], after: NDArray[np.float32], calibration: int) -> Moved:
    """Return how far N x 2 answers moved."""
    by = np.abs(after - before)
    return Moved(float(by.mean(0).max()), float(by.max()), calibration)


def quantised(
    model: onnx.ModelProto, images: NDArray[np.float32], settings: NDArray[np.float32]
) -> onnx.ModelProto:
    """Return `model` with integer convolutions, scaled for what N samples bring about in it.

    Weights have 7 of the 8 bits: a processor without VNNI adds two products in 16 bits, where
    those of 8 bits would not fit, and so all processors answer alike.
    """
    known = onnx.ModelProto()
    known.CopyFrom(model)
    add_pre_process_metadata(known)  # the exporter has inferred all shapes already
    with TemporaryDirectory(prefix="rig-int8-") as folder:
        path = Path(folder) / "int8.onnx"
        quantization.quantize_static(
            known,
            path,
            _OneByOne(_inputs(images, settings)),
            quant_format=quantization.QuantFormat.QDQ,
            op_types_to_quantize=list(OPERATORS),
            per_channel=True,
            reduce_range=True,
            activation_type=quantization.QuantType.QUInt8,
            weight_type=quantization.QuantType.QInt8,
            calibrate_method=quantization.CalibrationMethod.MinMax,
        )
        small: onnx.ModelProto = onnx.load(path)
    return small


Inputs = dict[str, NDArray[np.float32]]


def _inputs(images: NDArray[np.float32], settings: NDArray[np.float32]) -> Iterator[Inputs]:
    for at in range(len(images)):
        yield {"images": images[at : at + 1], "settings": settings[at : at + 1]}


class _OneByOne:
    """The calibration's reader: the next inputs, None behind the last."""

    def __init__(self, inputs: Iterator[Inputs]) -> None:
        self._inputs = inputs

    def get_next(self) -> Inputs | None:
        return next(self._inputs, None)
