"""The same network with its channels rounded up to whole vectors, for a faster ONNX file.

ONNX Runtime keeps pictures in blocks of 16 channels, one AVX-512 vector, only from one layer to
the next whose channels fill them; with 30 or 60 it rearranges all pixels in between. Channels of
zeros fill the blocks and change no answer.
"""

from __future__ import annotations

from torch import Tensor, nn

BLOCK = 16


def blocks(channels: int) -> int:
    """Return `channels` rounded up to whole blocks."""
    return -(-channels // BLOCK) * BLOCK


def filled(weights: Tensor, value: float = 0.0, axes: tuple[int, ...] = (0,)) -> Tensor:
    """Return `weights` with `axes` filled up to whole blocks by `value`."""
    shape = [blocks(size) if axis in axes else size for axis, size in enumerate(weights.shape)]
    wide = weights.new_full(shape, value)
    wide[tuple(slice(size) for size in weights.shape)] = weights
    return wide


def widened(stages: nn.Sequential) -> nn.Sequential:
    """Return convolution stages in evaluation whose inputs and outputs are whole blocks.

    The last stage must fill its blocks by itself, as 240, 480 and 512 channels do: the fully
    connected layers behind it stay as they are.
    """
    return nn.Sequential(*(_widened(layer) for layer in stages)).eval()


def _widened(layer: nn.Module) -> nn.Module:
    if isinstance(layer, nn.Conv2d):
        return _wide_convolution(layer)
    if isinstance(layer, nn.BatchNorm2d):
        return _wide_normalisation(layer)
    return layer


def _wide_convolution(layer: nn.Conv2d) -> nn.Conv2d:
    assert layer.bias is not None
    outputs, inputs = blocks(layer.out_channels), blocks(layer.in_channels)
    wide = nn.Conv2d(inputs, outputs, (layer.kernel_size[0], layer.kernel_size[1]))
    wide.weight = nn.Parameter(filled(layer.weight.detach(), axes=(0, 1)))
    wide.bias = nn.Parameter(filled(layer.bias.detach()))
    return wide


def _wide_normalisation(layer: nn.BatchNorm2d) -> nn.BatchNorm2d:
    assert layer.running_mean is not None and layer.running_var is not None
    wide = nn.BatchNorm2d(blocks(layer.num_features), eps=layer.eps)
    wide.weight = nn.Parameter(filled(layer.weight.detach()))
    wide.bias = nn.Parameter(filled(layer.bias.detach()))
    wide.running_mean = filled(layer.running_mean)
    wide.running_var = filled(layer.running_var, 1.0)
    return wide
