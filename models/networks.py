"""The thesis' convolutional networks: three pictures and their settings in, settings out.

A network sees the frames t, t-1 and t-2, newest first. In the thesis each frame brings five
channels: red, green, blue, and two constant planes of its exposure time and gain (thesis 4.2.5);
for the networks that choose the exposure time alone it brings four, without the gain.
Here pictures and settings stay apart: `images` is float32 N x 9 x 224 x 224 in 0..1 and
`settings` is float32 N x 6, (E_t, G_t, E_t-1, G_t-1, E_t-2, G_t-2) scaled to 0..1 by eq. 4.14.
All give (exposure, gain), N x 2, in 0..1 of the limits, not clamped.
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
from rig.core.types import THESIS_LIMITS
from rig.models.dataset import FRAMES
from rig.models.names import SCORE_MAPS

COLOURS = 3
CONVOLUTION_DROPOUT = 0.4
HEAD_DROPOUTS = (0.3, 0.2)

SINGLE_GAIN_DB = 10.0
"""The gain at which networks that choose the exposure time alone are taught and drive (4.2.1)."""


@dataclass(frozen=True, slots=True)
class Stage:
    """One valid convolution of stride 1 and the max pooling behind it; `pool` 1 is none."""

    channels: int
    kernel: int
    pool: int = 1


@dataclass(frozen=True, slots=True)
class Architecture:
    """The layers of one network and its number of parameters in thesis Table 4.1.

    `settings` is 2 for exposure and gain, 1 for the exposure alone; `normalised` says whether there
    is batch normalisation and dropout behind every layer. Without `stages` it is the ResNet-18.
    """

    stages: tuple[Stage, ...]
    hidden: tuple[int, ...]
    parameters: int
    settings: int = 2
    normalised: bool = True


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
        "single": Architecture(
            stages=tuple(Stage(channels, 3, 2) for channels in (16, 32, 64, 128, 256, 512)),
            hidden=(256, 128, 64),
            parameters=1_746_609,
            settings=1,
            normalised=False,
        ),
        "resnet18": Architecture(
            stages=(),
            hidden=(768, 384, 192),
            parameters=12_726_337,
            settings=1,
            normalised=False,
        ),
    }
)


def require_network(name: str) -> None:
    """Raise UsageError for a name that is not in NETWORKS."""
    if name not in NETWORKS:
        known = [*NETWORKS, *SCORE_MAPS]
        close = get_close_matches(name, known, n=1)
        hint = f"did you mean {close[0]!r}?" if close else f"choose from {', '.join(known)}"
        raise UsageError(f"unknown network {name!r}: {hint}")


def make_network(name: str) -> nn.Module:
    """Return a freshly initialised network; torch's random state decides the weights.

    Raises UsageError for a name that is not in NETWORKS.
    """
    require_network(name)
    architecture = NETWORKS[name]
    return ExposureNetwork(architecture) if architecture.stages else ResNet18(architecture)


def as_thesis_input(images: Tensor, settings: Tensor, per_frame: int = 2) -> Tensor:
    """Return the thesis' one tensor with settings as constant planes, N x 15 x 224 x 224.

    With one setting `per_frame`, the exposure, it has 12 channels.
    """
    planes = settings.reshape(-1, FRAMES, 2)[:, :, :per_frame, None, None]
    planes = planes.expand(-1, -1, -1, *images.shape[2:])
    colours = images.reshape(-1, FRAMES, COLOURS, *images.shape[2:])
    return torch.cat([colours, planes], 2).flatten(1, 2)


class FoldedConvolution(nn.Module):
    """The first convolution, over colours and the constant planes of `per_frame` settings a frame.

    A valid convolution turns a constant plane into a bias, value times the sum of the kernel,
    and a bias passes a max pooling unchanged. So only the nine colour channels are convolved and
    the settings are added after the pooling. Weights, outputs and gradients are those of the
    plain layer over all channels, for less than half of the arithmetic.
    """

    def __init__(self, stage: Stage, per_frame: int) -> None:
        super().__init__()
        channels = COLOURS + per_frame
        plain = nn.Conv2d(channels * FRAMES, stage.channels, stage.kernel)
        assert plain.bias is not None
        self.weight = nn.Parameter(plain.weight.detach())
        self.bias = nn.Parameter(plain.bias.detach())
        self.pool, self.per_frame = stage.pool, per_frame

    def forward(self, images: Tensor, settings: Tensor) -> Tensor:
        """Return the pooled responses of the plain layer to (images, settings)."""
        colour = functional.conv2d(images, self.image_weight(), self.bias)
        pooled = functional.max_pool2d(colour, self.pool)
        offset = functional.linear(settings, self.settings_weight())
        return pooled + offset[:, :, None, None].to(pooled.dtype)

    def image_weight(self) -> Tensor:
        """Return the kernels over the nine colour channels."""
        return self._by_frame()[:, :, :COLOURS].flatten(1, 2)

    def settings_weight(self) -> Tensor:
        """Return what one unit of each of the six settings adds to each output channel."""
        of_settings = self._by_frame()[:, :, COLOURS:].sum((3, 4))
        unused = of_settings.new_zeros(len(of_settings), FRAMES, 2 - self.per_frame)
        return torch.cat([of_settings, unused], 2).flatten(1)

    def _by_frame(self) -> Tensor:
        outputs, channels, *kernel = self.weight.shape
        return self.weight.reshape(outputs, FRAMES, channels // FRAMES, *kernel)


class ExposureNetwork(nn.Module):
    """A thesis network: convolution stages down to one pixel, then fully connected layers.

    Stage: convolution, max pooling, batch normalisation, ReLU, channel dropout. The last hidden
    layer has no ReLU and the output no activation: what drives a camera clamps it. Those that are
    not normalised have ReLUs alone.
    """

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        first, *others = architecture.stages
        self.first = FoldedConvolution(first, architecture.settings)
        behind = _normalised if architecture.normalised else _plain
        layers: list[nn.Module] = [*behind(first.channels)]
        channels = first.channels
        for stage in others:
            layers.append(nn.Conv2d(channels, stage.channels, stage.kernel))
            if stage.pool > 1:
                layers.append(nn.MaxPool2d(stage.pool))
            layers += behind(stage.channels)
            channels = stage.channels
        self.stages = nn.Sequential(*layers)
        self.head = nn.Sequential(*_head(channels, architecture))

    def forward(self, images: Tensor, settings: Tensor) -> Tensor:
        """Return the next (exposure, gain), N x 2, in 0..1 of the limits, not clamped."""
        features = self.stages(self.first(images, settings))
        return with_gain(self.head(torch.flatten(features, 1)))


class ResNet18(nn.Module):
    """The modified ResNet-18 of Table 4.1: each picture alone through one trunk, then 3 x 512.

    The published number of parameters leaves no weights for the exposure times, so each is added
    to its picture's features instead of appended to them. Weights begin at random: no pretrained
    ones are shipped.
    """

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        blocks = [_Residual(64, 64, 1), _Residual(64, 64, 1)]
        for inputs in (64, 128, 256):
            blocks += [_Residual(inputs, 2 * inputs, 2), _Residual(2 * inputs, 2 * inputs, 1)]
        self.trunk = nn.Sequential(
            nn.Conv2d(COLOURS, 64, 7, 2, 3, bias=False),
            nn.BatchNorm2d(64),
            nn.ReLU(),
            nn.MaxPool2d(3, 2, 1),
            *blocks,
            nn.AdaptiveAvgPool2d(1),
            nn.Flatten(),
        )
        self.head = nn.Sequential(*_head(512 * FRAMES, architecture))

    def forward(self, images: Tensor, settings: Tensor) -> Tensor:
        """Return the next (exposure, gain), N x 2, in 0..1 of the limits, not clamped."""
        pictures = images.reshape(-1, COLOURS, *images.shape[2:])
        exposures = settings.reshape(-1, FRAMES, 2)[:, :, :1]
        features = self.trunk(pictures).unflatten(0, (-1, FRAMES)) + exposures
        return with_gain(self.head(features.flatten(1)))


class _Residual(nn.Module):
    """Two 3 x 3 convolutions beside a shortcut (He et al., Deep residual learning, 2016)."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(),
            nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False),
            nn.BatchNorm2d(outputs),
        )
        self.shortcut: nn.Module = nn.Identity()
        if stride > 1:
            self.shortcut = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs)
            )

    def forward(self, features: Tensor) -> Tensor:
        together: Tensor = functional.relu(self.body(features) + self.shortcut(features))
        return together


def with_gain(answers: Tensor) -> Tensor:
    """Return answers of both settings as they are, and those of the exposure beside its gain."""
    if answers.shape[1] == 2:
        return answers
    low_db, high_db = THESIS_LIMITS.gain_db
    gain = (SINGLE_GAIN_DB - low_db) / (high_db - low_db)
    return answers * answers.new_tensor([1.0, 0.0]) + answers.new_tensor([0.0, gain])


def _normalised(channels: int) -> tuple[nn.Module, ...]:
    return nn.BatchNorm2d(channels), nn.ReLU(), nn.Dropout2d(CONVOLUTION_DROPOUT)


def _plain(_channels: int) -> tuple[nn.Module, ...]:
    return (nn.ReLU(),)


def _head(inputs: int, architecture: Architecture) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for index, width in enumerate(architecture.hidden):
        layers.append(nn.Linear(inputs, width))
        if not architecture.normalised:
            layers.append(nn.ReLU())
        else:
            layers.append(nn.BatchNorm1d(width))
            if index < len(HEAD_DROPOUTS):
                layers += [nn.ReLU(), nn.Dropout(HEAD_DROPOUTS[index])]
        inputs = width
    return [*layers, nn.Linear(inputs, architecture.settings)]
