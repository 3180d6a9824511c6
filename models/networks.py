"""The thesis' convolutional networks: three pictures and their settings in, settings out.

A network sees the frames t, t-1 and t-2, newest first. In the thesis each frame brings five
channels: red, green, blue, and two constant planes of its exposure time and gain (thesis 4.2.5).
Here pictures and settings stay apart: `images` is float32 N x 9 x 224 x 224 in 0..1 and
`settings` is float32 N x 6, (E_t, G_t, E_t-1, G_t-1, E_t-2, G_t-2) scaled to 0..1 by eq. 4.14.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from types import MappingProxyType

import torch
from torch import Tensor, nn
from torch.nn import functional

from rig.core.errors import UsageError
from rig.models.dataset import FRAMES

CHANNELS_PER_FRAME = 5
IMAGE_CHANNELS = tuple(5 * frame + colour for frame in range(FRAMES) for colour in range(3))
SETTING_CHANNELS = tuple(5 * frame + 3 + which for frame in range(FRAMES) for which in range(2))
CONVOLUTION_DROPOUT = 0.4
HEAD_DROPOUTS = (0.3, 0.2)


@dataclass(frozen=True, slots=True)
class Stage:
    """One valid convolution of stride 1 and the max pooling behind it; `pool` 1 is none."""

    channels: int
    kernel: int
    pool: int = 1


@dataclass(frozen=True, slots=True)
class Architecture:
    """The layers of one network and its number of parameters in thesis Table 4.1."""

    stages: tuple[Stage, ...]
    hidden: tuple[int, ...]
    parameters: int


NETWORKS: Mapping[str, Architecture] = MappingProxyType(
    {
        "dual-small": Architecture(
            stages=(Stage(30, 5, 3), Stage(60, 3, 3), Stage(120, 3, 3), Stage(240, 7)),
            hidden=(128, 64, 32),
            parameters=1_546_498,
        ),
        "dual-large": Architecture(
            stages=(
                Stage(30, 5, 3),
                Stage(60, 3, 2),
                Stage(120, 3, 2),
                Stage(240, 3, 2),
                Stage(480, 7),
            ),
            hidden=(240, 128, 32),
            parameters=6_150_322,
        ),
    }
)


def make_network(name: str) -> ExposureNetwork:
    """Return a freshly initialised network; torch's random state decides the weights.

    Raises UsageError for a name that is not in NETWORKS.
    """
    if name not in NETWORKS:
        close = get_close_matches(name, NETWORKS, n=1)
        hint = f"did you mean {close[0]!r}?" if close else f"choose from {', '.join(NETWORKS)}"
        raise UsageError(f"unknown network {name!r}: {hint}")
    return ExposureNetwork(NETWORKS[name])


def as_thesis_input(images: Tensor, settings: Tensor) -> Tensor:
    """Return the thesis' one tensor, N x 15 x 224 x 224, with settings as constant planes."""
    planes = settings[:, :, None, None].expand(-1, -1, *images.shape[2:])
    joined = images.new_empty(len(images), CHANNELS_PER_FRAME * FRAMES, *images.shape[2:])
    joined[:, IMAGE_CHANNELS] = images
    joined[:, SETTING_CHANNELS] = planes
    return joined


class FoldedConvolution(nn.Module):
    """The first convolution, over 15 channels of which six are constant planes.

    A valid convolution turns a constant plane into a bias, value times the sum of the kernel,
    and a bias passes a max pooling unchanged. So only the nine colour channels are convolved and
    the settings are added after the pooling. Weights, outputs and gradients are those of the
    plain 15-channel layer, for less than half of the arithmetic.
    """

    def __init__(self, stage: Stage) -> None:
        super().__init__()
        plain = nn.Conv2d(CHANNELS_PER_FRAME * FRAMES, stage.channels, stage.kernel)
        assert plain.bias is not None
        self.weight = nn.Parameter(plain.weight.detach())
        self.bias = nn.Parameter(plain.bias.detach())
        self.pool = stage.pool

    def forward(self, images: Tensor, settings: Tensor) -> Tensor:
        """Return the pooled responses of the plain layer to (images, settings)."""
        colour = functional.conv2d(images, self.image_weight(), self.bias)
        pooled = functional.max_pool2d(colour, self.pool)
        offset = functional.linear(settings, self.settings_weight())
        return pooled + offset[:, :, None, None].to(pooled.dtype)

    def image_weight(self) -> Tensor:
        """Return the kernels over the nine colour channels."""
        return self.weight[:, IMAGE_CHANNELS]

    def settings_weight(self) -> Tensor:
        """Return what one unit of each of the six settings adds to each output channel."""
        return self.weight[:, SETTING_CHANNELS].sum((2, 3))


class ExposureNetwork(nn.Module):
    """A thesis network: convolution stages down to one pixel, then fully connected layers.

    Stage: convolution, max pooling, batch normalisation, ReLU, channel dropout. The last hidden
    layer has no ReLU and the output no activation: what drives a camera clamps it.
    """

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        first, *others = architecture.stages
        self.first = FoldedConvolution(first)
        layers: list[nn.Module] = [*_normalised(first.channels)]
        channels = first.channels
        for stage in others:
            layers.append(nn.Conv2d(channels, stage.channels, stage.kernel))
            if stage.pool > 1:
                layers.append(nn.MaxPool2d(stage.pool))
            layers += _normalised(stage.channels)
            channels = stage.channels
        self.stages = nn.Sequential(*layers)
        self.head = nn.Sequential(*_head(channels, architecture.hidden))

    def forward(self, images: Tensor, settings: Tensor) -> Tensor:
        """Return the next (exposure, gain), N x 2, in 0..1 of the limits, not clamped."""
        features = self.stages(self.first(images, settings))
        next_settings: Tensor = self.head(torch.flatten(features, 1))
        return next_settings


def _normalised(channels: int) -> tuple[nn.Module, ...]:
    return nn.BatchNorm2d(channels), nn.ReLU(), nn.Dropout2d(CONVOLUTION_DROPOUT)


def _head(inputs: int, hidden: tuple[int, ...]) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for index, width in enumerate(hidden):
        layers += [nn.Linear(inputs, width), nn.BatchNorm1d(width)]
        if index < len(HEAD_DROPOUTS):
            layers += [nn.ReLU(), nn.Dropout(HEAD_DROPOUTS[index])]
        inputs = width
    return [*layers, nn.Linear(inputs, 2)]
